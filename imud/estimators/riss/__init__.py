"""Position, velocity and attitude of a land vehicle from three accelerometers, one gyro and a satellite receiver.

A reduced inertial sensor system (RISS), for sensors such as the Crossbow DMU RGA300CA. The vehicle moves in the
direction of its heading: its speed u is one state, and its lateral acceleration is u times its yaw rate. So the two
rates that are not measured are not needed. Roll and pitch are random walks. The accelerometers are not integrated; they
measure

    f_x = a cos(pitch) + g sin(pitch) + b_x
    f_y = u yaw_rate cos(roll) + (a sin(pitch) - g cos(pitch)) sin(roll) + b_y

where a is the longitudinal acceleration, a Gauss-Markov process. Acceleration and tilt are distinguished by the
receiver's velocity, and by how fast they change. Without a receiver the sigma of the tilt contains the acceleration.

A sensor of this kind computes its own roll and pitch from the same accelerometers, so they are no second measurement:
they are used where the forces are not valid, with the acceleration in their noise.

Sources: Noureldin, Karamat and Georgy, Fundamentals of Inertial Navigation, Satellite-based Positioning and their
Integration (2013), ch. 8 and 9 (RISS); Prasanna, Vehicle Localisation Using GPS and IMU (2009), for the sensors.
"""

from .. import Estimator
from ..odometer_source import SOURCE
from .filter import step
from .filter_states import filter_states, source_estimates
from .fixes import fuse_fix
from .state import TUNABLES, checkpoint, configure, resume, start
from .wheels import fuse_wheel_speed

ESTIMATOR = Estimator(
    "riss",
    configure,
    start,
    step,
    fuse_fix,
    needs_gyros=False,
    survives_power_on=True,
    tunables=TUNABLES,
    checkpoint=checkpoint,
    resume=resume,
    aid=fuse_wheel_speed,
    sources=(SOURCE,),
    filter_states=filter_states,
    source_estimates=source_estimates,
)
