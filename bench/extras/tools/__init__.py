"""Commands that use results and recordings: convert, undistort, rig and check."""
