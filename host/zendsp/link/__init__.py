"""link of zendsp."""
