"""Pictures: the only room of the core that imports matplotlib (extra `plot`)."""
