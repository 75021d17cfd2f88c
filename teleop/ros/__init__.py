"""ROS 2 without ROS: message types, their bytes and hashes, and what `rmw_zenoh` expects."""
