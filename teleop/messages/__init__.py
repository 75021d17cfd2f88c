"""Messages with a fixed layout, and the topics on which they are sent."""
