"""Emulated Crazyflie: firmware, body and radio, for the real cflib to connect to."""
