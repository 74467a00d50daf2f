"""What a reader gets: the page, its figures, the files, and the next motion."""
