#!/usr/bin/env bash
# A tracker or a receiver that dies during the check is no fitness, and so are millimetres and two robots on one body.
source "$(dirname "$0")/lib_devices.sh"
port=27311
natnet_team $port
natnet good 3 0 "ok   robot 0, source natnet"
natnet freeze 5 1 "fail robot 0, source natnet: no reading for the last"
expect freeze 1 "fail robot 1, source natnet: no reading for the last"
natnet frozen_stamp 5 1 "fail robot 1, source natnet: no reading for the last"
expect frozen_stamp 1 "source natnet" "repeats a frame or its stamp"
natnet lost_tail 5 1 "fail robot 1, source natnet: no reading for the last" "lost its rigid body"
expect lost_tail 1 "ok   robot 0, source natnet"
natnet millimetres 3 1 "fail robot 0, source natnet" "millimetres"
natnet one_body 3 1 "another robot has the same rigid body"
port=29851
gpsd_team $port 'fix_least = "rtk-fixed"'
gpsd good 3 0 "ok   robot 0, source gpsd:"
gpsd stale 6 1 "fail robot 0, source gpsd: no reading for the last" "has no fix in three dimensions"
gpsd frozen 6 1 "fail robot 0, source gpsd: no reading for the last"
gpsd two 3 1 "several receivers"
