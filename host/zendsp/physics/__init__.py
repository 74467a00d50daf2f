"""physics of zendsp."""
