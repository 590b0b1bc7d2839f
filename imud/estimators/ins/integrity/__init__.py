"""Fault detection: does the receiver drift, have its stamps or the gyro bias stepped, are heading and gyro bias right?

`fusion` carries the effects that the tests look for along with P; `gnss_position`, `gnss_fix` and `imu_sample` decide.
"""
