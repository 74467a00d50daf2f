"""Parts of the screens that show one thing each."""
