"""A ROS node in the place of the hand."""
