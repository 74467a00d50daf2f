"""Machines simulated by MuJoCo: equations and numerics that neither zendsp nor its own proof wrote.
"""
