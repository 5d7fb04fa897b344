"""Simulated stage controllers (Zaber, XIMC, GRBL, ESP301), and the motion of the axes behind them."""
