"""The parts of identify_node."""
