"""Training: the only package besides export that may import torch."""
