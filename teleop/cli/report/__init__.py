"""Parts of reports: page, style of figures, progress bar."""
