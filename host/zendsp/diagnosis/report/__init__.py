"""What a reader gets: the page, its figures and the files."""
