"""zendsp: rapid control prototyping over a network link."""

__version__ = "0.1.0"
