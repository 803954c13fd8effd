#!/usr/bin/env bash
# What `murmurate doctor` says of Wi-Fi, and what a record has of it, held against Linux itself: a Debian kernel with simulated cards (mac80211_hwsim)
# in a virtual machine, and what `iw` says there.
#
#   bash tests/peers/wifi/full.sh target/release/murmurate       1 minute; needs qemu-system-x86, busybox-static, iw,
#                                                                cpio, iproute2 and apt-get (70 MB)
set -euo pipefail
program=$(realpath "$1")
here=$(realpath "$(dirname "$0")")
work=${WIFI_FOLDER:-$(mktemp -d)}
mkdir -p "$work" && cd "$work"

if [ ! -d kernel ]; then
    package=$(apt-cache depends linux-image-amd64 | grep -o 'linux-image-[0-9][^ ]*' | head -1)
    apt-get download "$package" >/dev/null 2>&1
    dpkg-deb -x "$package"_*.deb kernel
fi
modules=$(echo kernel/lib/modules/*/kernel)

rm -rf root && mkdir -p root/{bin,proc,sys,dev,tmp,run,etc,usr/sbin,modules}
cp "$(command -v busybox)" root/bin/
for tool in sh mount insmod sleep ping poweroff su mkdir cat grep sed chown tr timeout; do ln -s busybox root/bin/$tool; done
order=(drivers/virtio/virtio_ring drivers/virtio/virtio lib/crypto/libarc4 net/rfkill/rfkill net/wireless/cfg80211
    net/mac80211/mac80211 drivers/net/wireless/mac80211_hwsim)
for module in "${order[@]}"; do cp "$modules/$module.ko" root/modules/; done
for one in "$program" "$(command -v iw)" "$(command -v ip)"; do
    cp "$one" root/usr/sbin/
    ldd "$one" | grep -o '/[^ ]*' | while read -r library; do
        mkdir -p "root/$(dirname "$library")" && cp -L "$library" "root/$library"
    done
done
strip "root/usr/sbin/$(basename "$program")"
cp "$here"/inside.sh "$here"/team.toml root/
echo 'nobody:x:65534:65534:nobody:/:/bin/sh' >root/etc/passwd
{
    echo '#!/bin/sh'
    echo 'export PATH=/usr/sbin:/bin'
    echo 'mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev; mount -t tmpfs run /run'
    echo 'cd /modules'
    for module in "${order[@]}"; do echo "insmod $(basename "$module").ko$([[ $module != *hwsim ]] || echo ' radios=3')"; done
    echo '/usr/sbin/ip link set lo up; cd /; sh /inside.sh 2>&1; poweroff -f'
} >root/init
chmod +x root/init
(cd root && find . | cpio -o -H newc --quiet | gzip -1) >root.gz

timeout 300 qemu-system-x86_64 -accel tcg -cpu max -m 1024 -nographic -no-reboot -kernel kernel/boot/vmlinuz-* \
    -initrd root.gz -append 'console=ttyS0 quiet panic=1 tsc=reliable' >console.txt 2>&1
tr -d '\r' <console.txt | sed -n '/^== /,$p' | grep -v '^\[' | tee said.txt

says() { # PART TEXT...: refuses a part of the output that lacks a text
    local part=$1 text
    shift
    for text in "$@"; do
        sed -n "/^== $part\$/,/^== /p" said.txt | grep -qF -- "$text" || { echo "'$part' lacks: $text" >&2 && exit 1; }
    done
}
says 'no network' 'none is set: channels at 5 GHz' 'managed, on no channel' 'ip link set wlan0 down && iw dev wlan0 set type ibss && ip link set wlan0 up && iw dev wlan0 ibss join NAME'
says 'power saving' 'frames wait until the card wakes' 'iw dev wlan0 set power_save off'
says 'ad hoc' "IBSS of 'team' at 2412 MHz" '"found":"off"' 'set mcast_rate 24' '1 heard, the weakest 02:00:00:00:01:00'
says 'samples' 'time_s,interface,mode,frequency_mhz' ',wlan0,IBSS,2412,' ',02:00:00:00:01:00,-'
if [ "$(sed -n '/^== samples$/,/^== /p' said.txt | grep -c ',wlan0,')" -lt 4 ]; then
    echo 'fewer than four samples in six seconds' >&2 && exit 1
fi
says 'as nobody' "IBSS of 'team' at 2412 MHz" '1 heard' '"fit":true'
says 'mesh point' 'mesh point at 2412 MHz' 'set mesh_param mesh_fwding 0'
says 'mesh point that does not forward' 'mesh point at 2412 MHz'
if sed -n '/^== mesh point that does not forward$/,$p' said.txt | grep -q mesh_fwding; then
    echo 'a mesh point that does not forward is warned of' >&2 && exit 1
fi
says 'iw' 'country 00' 'Station 02:00:00:00:01:00 (on wlan0)' 'type IBSS' 'ssid team'
echo "the doctor and Linux's mac80211 say the same of their cards"
