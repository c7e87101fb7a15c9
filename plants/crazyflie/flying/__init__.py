"""Flying a connected Crazyflie: setpoints, watchdog, telemetry, inspection."""
