"""Directions on the sphere, rotations and quaternions: each formula once."""
