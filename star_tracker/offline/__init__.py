"""Files without ROS: images, lists of centroids and star maps in, attitudes and headers out."""
