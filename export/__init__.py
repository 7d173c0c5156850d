"""From torch to ONNX: convert, verify."""
