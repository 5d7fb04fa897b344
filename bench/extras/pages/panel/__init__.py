"""Pages that show runs and batches: reads journals, puts requests into inboxes, never opens a device."""
