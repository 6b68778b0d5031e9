"""The camera: pixels, lens distortion, and a frame's centroids as directions."""
