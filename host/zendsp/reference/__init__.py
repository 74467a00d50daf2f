"""reference of zendsp."""
