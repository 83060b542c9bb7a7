"""The toolbox of those who write detectors and attacks: what a receiver and an IMU say of motion.

Vectors are rows, shape ``(n, 3)``. Those in a level frame are NED: north, east, down. Those of an
IMU are in the sensor frame as recorded. What is unknown is NaN. A result at a time rests on rows
at or before it: nothing here interpolates towards a later row, and nothing is smoothed both ways.

============================  ====================================================================
:mod:`.gnss`                  which epochs have a fix, velocity however it is reported; metres per
                              radian, local positions, gravity and rotation of the Earth
:mod:`.imu`                   axes, means between epochs, standing still
:mod:`.preintegration`        attitude, velocity and position that an IMU gains between epochs
============================  ====================================================================
"""
