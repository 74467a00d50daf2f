"""tui of zendsp."""
