"""The lowest level of the bench: errors, time, folders and processes of this computer. Imports no other level."""
