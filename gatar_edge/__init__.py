"""Decentralized task allocation for mixed teams of aerial and ground robots, on the robots."""

__version__ = "0.1.0"
