"""What centroid_node is made of."""
