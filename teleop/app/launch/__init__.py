"""Starting a whole session and looking after it until it ends."""
