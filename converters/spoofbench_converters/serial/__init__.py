"""Byte streams of a receiver's serial port: NMEA 0183, UBX and RTCM 3, alone or mixed, every byte
with one owner.

A frame changes its form seven times on its way to a recording:

1. bytes, read in pieces (``demux``);
2. ``Frames`` of one protocol, found by ``framing`` and given their lines by ``demux``; what is left
   over are rejects (``gaps``);
3. structured rows of each message, or columns of each type of sentence, in the decoder of the
   protocol (``ubx``, ``nmea``);
4. ``EpochRows`` of one kind and source, and the ``Epochs`` that they belong to (``contract``);
5. ``TimedEpochs``: ``dates`` completes what epochs claim, ``time_axis`` follows the clock, and
   ``rows`` lays sensors' own clocks against it;
6. ``RowBatch``, put in the order of time by a ``RowBuffer``;
7. a ``Table``, yielded as a block by ``conversion``.
"""
