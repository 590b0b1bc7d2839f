"""What has to see each propagation and each update of the Kalman filter: `fusion` calls it, it calls nothing above."""
