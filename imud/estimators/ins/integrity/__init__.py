"""Fault detection: does the receiver drift, are heading and gyro bias right? `fusion` calls the drift test."""
