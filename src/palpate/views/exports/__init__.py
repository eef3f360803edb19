"""Exports of a recorded session: CSV, MCAP and ROS 2 bags, for viewers and other programs."""
