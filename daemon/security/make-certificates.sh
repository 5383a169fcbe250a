#!/bin/sh
# A certificate authority of your own and a certificate for each who takes part. See docs/security.md.
#
#   make-certificates.sh [-H HOST]... [-d DAYS] FOLDER [NAME...]
#
# FOLDER/ca-key.pem stays with you, off the robot: who has it can be anybody. FOLDER/NAME holds
# what NAME needs: ca.pem, cert.pem, key.pem. The name is what the router's rules go by; only the
# one called router can be a server. HOST is a name or address that others reach the router under,
# beside localhost. Run again it adds names, or makes new certificates for old ones.
set -eu
umask 077

hosts="DNS:localhost,IP:127.0.0.1,IP:::1"
days=365
while getopts H:d: option; do
    case $option in
    H) case $OPTARG in
        *[!0-9.]*) hosts="$hosts,DNS:$OPTARG" ;;
        *) hosts="$hosts,IP:$OPTARG" ;;
        esac ;;
    d) days=$OPTARG ;;
    *) sed -n '2,9s/^# \{0,1\}//p' "$0" >&2 && exit 2 ;;
    esac
done
shift $((OPTIND - 1))
if [ $# -lt 1 ]; then
    sed -n '2,9s/^# \{0,1\}//p' "$0" >&2
    exit 2
fi
folder=$1
shift
[ $# -gt 0 ] || set -- router daemon reader commander

quietly() {
    out=$("$@" 2>&1) || {
        echo "$out" >&2
        exit 1
    }
}

mkdir -p "$folder"
if [ ! -e "$folder/ca-key.pem" ]; then
    quietly openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -noenc -days 3650 \
        -subj "/CN=ertis authority" -addext "basicConstraints=critical,CA:TRUE" \
        -addext "keyUsage=critical,keyCertSign,cRLSign" \
        -keyout "$folder/ca-key.pem" -out "$folder/ca.pem"
fi
for name; do
    case $name in
    "" | . | .. | */*)
        echo "$0: '$name' is no name for a certificate and its folder" >&2
        exit 2
        ;;
    esac
    mine=$folder/$name
    mkdir -p "$mine"
    quietly openssl req -new -newkey ec -pkeyopt ec_paramgen_curve:P-256 -noenc \
        -subj "/CN=$name" -keyout "$mine/key.pem" -out "$mine/request.pem"
    if [ "$name" = router ]; then
        use="extendedKeyUsage=serverAuth,clientAuth\nsubjectAltName=$hosts"
    else
        use="extendedKeyUsage=clientAuth"
    fi
    printf '%b\n' "basicConstraints=CA:FALSE" "keyUsage=digitalSignature" "$use" \
        >"$mine/extensions"
    quietly openssl x509 -req -in "$mine/request.pem" -days "$days" -extfile "$mine/extensions" \
        -CA "$folder/ca.pem" -CAkey "$folder/ca-key.pem" -CAcreateserial -out "$mine/cert.pem"
    rm "$mine/request.pem" "$mine/extensions"
    cp "$folder/ca.pem" "$mine/ca.pem"
    echo "$mine: for $name, until $(openssl x509 -in "$mine/cert.pem" -noout -enddate | cut -d= -f2)"
done
