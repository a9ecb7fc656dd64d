#!/bin/sh
# Make a certificate authority, and a certificate for each machine: ./certificates.sh DIR HOST...
# Copy DIR/HOST/ (ca.pem, server.pem, server.key) to the machine. Keep DIR/ca.key here.
# The certificates conform to RFC 5280, because Python requires that from 3.13 on.
set -eu
[ $# -ge 2 ] || { echo "usage: $0 DIR HOST..." >&2; exit 2; }
directory=$1
shift
umask 077
mkdir -p "$directory"
if [ ! -e "$directory/ca.key" ]; then
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 3650 \
        -subj "/CN=modbus fleet authority" -addext keyUsage=critical,keyCertSign,cRLSign -keyout "$directory/ca.key" -out "$directory/ca.pem" \
        2>/dev/null
fi
for host in "$@"; do
    mkdir -p "$directory/$host"
    case $host in
    *[!0-9.]*) name="DNS:$host" ;;
    *) name="IP:$host" ;;
    esac
    openssl req -new -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -subj "/CN=$host" \
        -keyout "$directory/$host/server.key" -out "$directory/$host/request" 2>/dev/null
    cat >"$directory/$host/extensions" <<END
subjectAltName=$name
keyUsage=critical,digitalSignature
extendedKeyUsage=serverAuth,clientAuth
subjectKeyIdentifier=hash
authorityKeyIdentifier=keyid
END
    openssl x509 -req -in "$directory/$host/request" -days 825 -CA "$directory/ca.pem" \
        -CAkey "$directory/ca.key" -CAcreateserial -extfile "$directory/$host/extensions" \
        -out "$directory/$host/server.pem" 2>/dev/null
    rm "$directory/$host/request" "$directory/$host/extensions"
    cp "$directory/ca.pem" "$directory/$host/"
    echo "$directory/$host"
done
