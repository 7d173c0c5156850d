"""Rules that choose targets, all behind one interface: `base.Allocator`."""
