"""`python -m gatar_edge` is `gatar`."""

from gatar_edge.cli import main

main()
