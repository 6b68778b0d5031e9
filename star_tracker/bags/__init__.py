"""Bags of ROS 1 and ROS 2 without ROS: frames and cameras in, attitudes out."""
