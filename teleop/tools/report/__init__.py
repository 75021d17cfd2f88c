"""What reports are made of: a page, the style of figures, a progress bar."""
