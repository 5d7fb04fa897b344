"""The lowest level: errors, time, and the folders of this computer. Imports nothing of the bench."""
