"""How fast simulation time may pass, as a factor of real time."""

MIN_SPEED = 0.01
"""The smallest factor that is not 0, as fast as possible."""
MAX_SPEED = 1000.0
