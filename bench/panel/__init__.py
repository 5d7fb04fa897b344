"""Pages that show runs and batches in progress: `starbench panel`.

This room reads journals and puts requests into inboxes. It never opens a device.
"""
