"""Bytes into values and values into bytes: the layer between ports and everything else.

`transport` opens ports, real or emulated, and keeps time. `dynamixel` and `tactile` speak to servos and
arrays on them. `finger` turns servo angles into places of a tip. `emulators` stands in for the devices;
nothing else in this package imports it. Knows neither objects nor recognition nor configuration files.
"""
