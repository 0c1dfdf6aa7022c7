"""The demonstration: its site, its frames, its broker and its plot."""
