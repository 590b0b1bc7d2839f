"""Position, velocity and attitude of a land vehicle from three accelerometers, one gyro and a satellite receiver.

The reduced inertial sensor system (RISS) of the field, for sensors such as the Crossbow DMU RGA300CA. The vehicle moves
where it points: its speed u along its heading is one state, and its force across is u times its yaw rate. So the two
rates that are not measured are not needed. Roll and pitch are random walks; the accelerometers do not drive the
position: they measure

    f_x = a cos(pitch) + g sin(pitch) + b_x
    f_y = u yaw_rate cos(roll) + (a sin(pitch) - g cos(pitch)) sin(roll) + b_y

and acceleration a (a Gauss-Markov process) and tilt are distinguished by the receiver's velocity, and by how fast they
change. Without a receiver that part of the tilt's sigma stays which an unknown acceleration leaves.

A sensor of this kind can have computed its own roll and pitch from nothing but these accelerometers. They are therefore
no second measurement: they are used where the forces are not valid, with the acceleration in their noise.

Sources: Noureldin, Karamat and Georgy, Fundamentals of Inertial Navigation, Satellite-based Positioning and their
Integration (2013), ch. 8 and 9 (RISS); Prasanna, Vehicle Localisation Using GPS and IMU (2009), for the sensors.
"""

from .. import Estimator
from ..odometer_source import SOURCE
from .filter import step, update
from .state import TUNABLES, checkpoint, configure, resume, start
from .wheels import fuse_wheel_speed

ESTIMATOR = Estimator(
    "riss",
    configure,
    start,
    step,
    update,
    needs_gyros=False,
    survives_power_on=True,
    tunables=TUNABLES,
    checkpoint=checkpoint,
    resume=resume,
    aid=fuse_wheel_speed,
    sources=(SOURCE,),
)
