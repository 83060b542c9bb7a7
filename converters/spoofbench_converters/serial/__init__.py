"""Byte streams of a receiver's serial port: NMEA 0183, UBX and RTCM 3, alone or mixed, every byte
with one owner.
"""
