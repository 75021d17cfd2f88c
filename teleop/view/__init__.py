"""What a session looks like: messages from the link or a recording, shown or saved with Rerun."""
