"""Frames from files and from simulation: star maps, a user's centroids, synthetic fields."""
