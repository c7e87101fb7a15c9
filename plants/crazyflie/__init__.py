"""The Crazyflie: simulated, real, and emulated for the real radio library.

Imports `dcf_zenoh.plant`, `.spec`, `.graph` and `.errors` only.
"""
