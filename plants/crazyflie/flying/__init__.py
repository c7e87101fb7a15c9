"""Flying a real Crazyflie once it is connected: setpoints, watchdog, telemetry, inspection."""
