"""Pictures of fields and of the sky. They need matplotlib (extra `plot`)."""
