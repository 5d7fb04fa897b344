"""State of the simulated world over time: angles of the axes, light, temperature."""
