"""Lets the tests of this folder import their helpers (importlib mode adds no folder to the path).
"""


