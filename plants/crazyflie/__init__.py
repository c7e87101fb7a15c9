"""Crazyflie: simulated, real, and emulated for cflib.

Imports `dcf_zenoh.plant`, `.spec`, `.graph` and `.errors` only.
"""
