"""The paper's tables and figures on our own worlds: trains what they compare, judges it, flies it, draws it."""
