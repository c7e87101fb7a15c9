"""Nonlinear model and the firmware's controllers, compiled to machine code."""
