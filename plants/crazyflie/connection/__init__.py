"""The radio link to a real Crazyflie."""
