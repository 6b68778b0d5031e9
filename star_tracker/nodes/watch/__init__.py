"""The live view of a running identify_node."""
