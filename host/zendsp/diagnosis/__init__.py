"""diagnosis of zendsp."""
