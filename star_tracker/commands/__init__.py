"""The commands `star_tracker ...`, a module each. No ROS is needed for them."""
