"""Images: found stars become centroids, and a catalogue becomes an image."""
