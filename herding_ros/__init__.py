"""Herds a randomly moving crowd with a few robots by space-mapping receding-horizon control."""

__version__ = '0.1.0'
