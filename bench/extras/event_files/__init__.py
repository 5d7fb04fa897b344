"""Event files of other programs: AEDAT4 and bags of ROS, read through their libraries."""
