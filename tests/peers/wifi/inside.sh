# What runs in the virtual machine: cards in each mode, and what the doctor and iw say of them.
doctor() { murmurate doctor /team.toml --host robot-0 --listen 0 --json | tr '{' '\n' | grep -E 'Wi-Fi|saving|country|multicast|peers'; }
# Not that of busybox, which its shell takes first.
ip() { /usr/sbin/ip "$@"; }

# Any 32 bytes: nothing is sent.
(umask 077 && echo 00112233445566778899aabbccddeeff00112233445566778899aabbccddeeff >/run/team.key)
ip link set wlan0 up
ip addr add 10.5.0.1/24 dev wlan0
echo '== no network'
doctor
echo '== power saving'
iw dev wlan0 set power_save on
doctor

# The second card is of another machine: in one network namespace, frames between them would not be on the air.
mkdir -p /run/netns
ip netns add other
iw phy phy1 set netns name other
there='/usr/sbin/ip netns exec other'
# As the doctor says, and with a BSSID: networks of two names would have to find each other first.
ip link set wlan0 down && iw dev wlan0 set type ibss && ip link set wlan0 up && iw dev wlan0 ibss join team 2412 HT20 \
    fixed-freq 02:11:22:33:44:55 basic-rates 6,12,24 mcast-rate 24
$there iw dev wlan1 set type ibss
$there /usr/sbin/ip link set wlan1 up
$there /usr/sbin/ip addr add 10.5.0.2/24 dev wlan1
join='ibss join team 2412 HT20 fixed-freq 02:11:22:33:44:55 basic-rates 6,12,24 mcast-rate 24'
$there iw dev wlan1 $join
sleep 2
ping -c 3 -i 0.2 10.5.0.2 >/dev/null
echo '== ad hoc'
doctor
echo '== samples'
timeout -s INT 6 murmurate host /team.toml --host robot-0 --record /tmp/record >/dev/null 2>/tmp/said || cat /tmp/said
murmurate record export /tmp/record/*.mcap --wifi /tmp/wifi.csv
cat /tmp/wifi.csv
chown 65534 /run/team.key
echo '== as nobody'
su nobody -s /bin/sh -c 'murmurate doctor /team.toml --host robot-0 --listen 0 --json'
chown 0 /run/team.key
echo '== iw'
iw reg get
iw dev wlan0 info
iw dev wlan0 station dump

ip link set wlan0 down && iw dev wlan0 set type mp && ip link set wlan0 up && iw dev wlan0 mesh join team freq 2412
sleep 1
echo '== mesh point'
doctor
iw dev wlan0 set mesh_param mesh_fwding 0
echo '== mesh point that does not forward'
doctor
echo '== end'
