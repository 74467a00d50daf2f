"""proof of zendsp."""
