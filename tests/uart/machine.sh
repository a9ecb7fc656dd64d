# Make vmlinuz, Debian's kernel for virtual machines, and initramfs: the Python of a virtual
# environment, $1, which starts first; the wheel as it is built; and guest.py.
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
python=$(readlink -f "$1")
library=$("$1" -c 'import os; print(os.path.dirname(os.__file__))')
ln -s "$python" root/init
libraries=$(find "$python" "$library/lib-dynload" root/site -name '*.so' -o -path "$python" |
    xargs ldd | sed -n 's/^[^/]*\(\/[^ ]*\) (0x.*/\1/p' | sort -u)
tar -chP --exclude=*/site-packages --exclude=*/test --exclude=*/config-* \
    "$python" "$library" $libraries | tar -xP --transform='s,^/,root/,'
cd root
find . | cpio --quiet -o -H newc >../initramfs
