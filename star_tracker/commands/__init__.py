"""The commands `star_tracker ...`, a module each. Only `watch` needs ROS."""
