"""experiment of zendsp."""
