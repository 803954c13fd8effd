#!/usr/bin/env bash
# A fix without a course or a speed is a position where no velocity is needed; else the reason is shown.
source "$(dirname "$0")/lib_devices.sh"
port=29871
for scene in no_track no_speed; do
    for more in 'heading = "none"' 'heading = "none", fuse = { heading_rad = 0.0 }'; do
        gpsd_team $port "fix_least = \"3d\", $more"
        # With `fuse` poses come at odometry, which the driver `program` has not: the fixes must not be refused.
        case $more in
            *fuse*) gpsd $scene 3 1 "no reading of robot 0" && ! grep -q "speed" <<<"$said" || fail "$scene: refused" "$said" ;;
            *) gpsd $scene 3 0 "robot 0, source gpsd: " ;;
        esac
    done
    gpsd_team $port 'fix_least = "3d"'
    sed -i '1i estimator = "kalman"' team.toml
    gpsd $scene 3 0 "robot 0, source gpsd: "
    gpsd_team $port 'fix_least = "3d"'
    gpsd $scene 3 1 "no reading of robot 0" "speed"
done
# A leap second and a receiver's clock that is set back cost no stop.
gpsd_team $port 'heading = "none"'
gpsd leap 6 0 "ok   robot 0, source gpsd:"
gpsd clock_back 6 0 "robot 0, source gpsd:"
