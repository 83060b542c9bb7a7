"""Convert, attack, detect, score: which GNSS spoofing detector can be trusted?

Data go one way, from file to file::

    raw log -> recording (.mcap) -> attacked variant (.mcap) -> decisions -> scores (.parquet) ->
    report

Words used everywhere
---------------------
recording   what one session's sensors said: tables by topic, and metadata
topic       ``/<source>/<kind>``, such as ``/gnss0/gnss/pvt``; ``/reference/pva``,
            ``/truth/attack`` and ``/truth/clean`` belong to no source
source      a receiver, an IMU, a phone's location provider: ``gnss0``, ``imu0``
kind        what a row is: ``imu``, ``gnss/pvt``, ``mag``, ...; the protobuf schema lists the fields
            of each
variant     a recording after an attack; its clean recording is its base
epoch       one row of the primary ``gnss/pvt``
decision    a detector's score and availability at one time; alert = available and score > 1
task        one detector on one recording, attacked or not

Time
----
Every row has ``time_ns``: time of measurement on the recording's clock, Unix UTC in int64
nanoseconds,
non-decreasing within a topic. Intervals are half-open. What a receiver claims about time (week,
time of week) are fields: a spoofer controls them.

Frames and units
----------------
Names carry units. Latitude, longitude and ``height_m`` are geodetic on the ellipsoid,
``height_msl_m`` is
above mean sea level. Velocities are NED. Inertial and magnetic data are in the sensor's frame as
recorded;
specific force points up at rest. Attitude is roll, pitch, yaw of a forward-right-down body against
NED.

Absent is absent
----------------
An absent float is NaN; every other column has a validity mask. Zero is zero. Unknown is null, never
0.
"""

__version__ = "0.1.0"
