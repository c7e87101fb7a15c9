"""Radio link to a real Crazyflie."""
