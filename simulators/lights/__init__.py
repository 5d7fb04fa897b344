"""Simulated light drivers (function generators and a strobe controller), and the lamp behind them."""
