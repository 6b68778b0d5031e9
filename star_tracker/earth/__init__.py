"""The attitude against the Earth: its rotation, places on it, aberration and refraction."""
