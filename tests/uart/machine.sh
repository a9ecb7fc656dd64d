# Make vmlinuz, Debian's kernel for virtual machines, and initramfs: a Python, the wheel as it is
# built, and guest.py. $1: the Python of the virtual environment; $2: its file; $3: its library.
set -eu
mkdir -p build/uart
cd build/uart
if [ ! -e vmlinuz ]; then
    name=$(apt-cache depends linux-image-cloud-amd64 | sed -n 's/.*Depends: //p' | head -n 1)
    apt-get download -qq -o APT::Sandbox::User=root "$name"
    dpkg-deb -x "$name"_*.deb .
    mv boot/vmlinuz-* vmlinuz
fi
rm -rf root
mkdir -p root/site root/proc root/sys root/dev root/tmp
"$1" -m pip install -q --disable-pip-version-check --no-build-isolation --target root/site ../..
cp ../../tests/uart/guest.py root/site
printf '#!%s -u\nimport guest\n' "$2" >root/init
chmod +x root/init
libraries=$(find "$2" "$3/lib-dynload" root/site -name '*.so' -o -path "$2" |
    xargs ldd | sed -n 's/^[^/]*\(\/[^ ]*\) (0x.*/\1/p' | sort -u)
tar -ch --exclude=*/site-packages --exclude=*/test --exclude=*/config-* \
    -C / "${2#/}" "${3#/}" $(echo "$libraries" | sed 's/^.//') | tar -x -C root
cd root
find . | cpio --quiet -o -H newc >../initramfs
