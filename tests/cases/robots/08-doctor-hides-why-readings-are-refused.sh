#!/usr/bin/env bash
# doctor names the reason that the program knows, for trackers and for receivers.
source "$(dirname "$0")/lib_devices.sh"
port=27321
natnet_team $port
natnet blank 3 1 "no rigid body 'robot-0'" "'robot-0 '" "blanks and capitals count"
natnet capital 3 1 "no rigid body 'robot-0'" "'Robot-0'"
natnet twice 3 1 "several rigid bodies 'robot-0'" "1, 7"
natnet no_bodies 3 1 "does it stream rigid bodies?"
natnet unicast 3 1 "sends by unicast: set \`transmission\`"
natnet old 3 1 "sends a bitstream before 3.0"
port=29861
gpsd_team $port 'fix_least = "rtk-fixed"'
gpsd far 3 1 "over 100 km from the origin"
gpsd no_speed 3 1 "has no speed: does the receiver send RMC"
gpsd no_track 3 1 "a speed and no course"
gpsd no_rtk 3 1 "worse than fix_least"
gpsd no_time 3 1 "does not know the time"
gpsd sky 4 1 "no position (TPV)"
gpsd none 3 1 "gpsd has no receiver"
gpsd_team $port 'device = "/dev/ttyUSB9"'
gpsd good 4 1 "other receivers than \`device\`"
expect good 1 "'/dev/ttyACM0'"
