"""A ROS 2 node that finds snap joints in the pictures of a GelSight-like tactile sensor."""
