#!/bin/sh
# Make the template of a unit from a unit of deploy/: template.sh COMMAND <UNIT >TEMPLATE
set -eu
file=/etc/libmodbus-py/%i.toml
state='--log info --audit ${STATE_DIRECTORY}/audit.json'
case $1 in
serve) start="serve \${URL} --device $file --state \${STATE_DIRECTORY}/state.json $state" ;;
gateway) start="gateway --config $file $state" ;;
poll) start="poll $file --log info" ;;
esac
sed -e "s|^\(Description=.*\)|\1, %i|" \
    -e 's/^Description=Modbus: one worker of a fleet,/Description=Modbus: readings of devices,/' \
    -e "s|^ExecStart=.*|ExecStart=/usr/bin/libmodbus-py $start|" \
    -e "s|^StateDirectory=.*|StateDirectory=libmodbus-py/$1-%i|" \
    -e 's/ nats-server.service//' -e '/^EnvironmentFile=/d' \
    -e '/^TimeoutStartSec=/d' -e '/^StartLimitIntervalSec=/d' \
    -e '/^# Restart without limit/d' -e '/^# It waits for the engine/d' |
    if [ "$1" = serve ]; then
        sed -e 's|^Type=notify|&\n# Where it listens; URL= in the second file changes it.\nEnvironment=URL=tcp://0.0.0.0:502\nEnvironmentFile=-/etc/libmodbus-py/%i.env|'
    else
        cat
    fi
