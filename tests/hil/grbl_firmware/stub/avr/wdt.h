// The watchdog is not used.
