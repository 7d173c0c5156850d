"""The commands of the command line, one file each; composition roots that may import anything."""
