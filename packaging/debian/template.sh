#!/bin/sh
# Make the template of a unit from a unit of deploy/: template.sh COMMAND <UNIT >TEMPLATE
set -eu
file=/etc/libmodbus-py/%i.toml
state='--log info --audit ${STATE_DIRECTORY}/audit.json'
case $1 in
serve)
    start="serve \${URL} --device $file --state \${STATE_DIRECTORY}/state.json $state"
    where='# Where it listens; URL= in the file below changes it.\nEnvironment=URL=tcp://0.0.0.0:502\n'
    ;;
gateway) start="gateway --config $file $state" where= ;;
poll) start="poll $file --log info" where= ;;
esac
sed -e "s|^\(Description=.*\)|\1, %i|" \
    -e "s|^ExecStart=.*|ExecStart=/usr/bin/libmodbus-py $start|" \
    -e "s|/var/lib/libmodbus-py-poll/|/var/lib/libmodbus-py/poll-NAME/|" \
    -e "s|^StateDirectory=.*|StateDirectory=libmodbus-py/$1-%i|" \
    -e "s|^# Secrets|${where}&|" \
    -e "s|^EnvironmentFile=.*|EnvironmentFile=-/etc/libmodbus-py/%i.env|"
