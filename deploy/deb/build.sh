#!/bin/sh
# build.sh PYTHON WHEELHOUSE OUT: a .deb of what is in WHEELHOUSE, for the Debian whose python3.X PYTHON is.
# PYTHON has cellward installed; it stages the files that 'cellward install' would make.
set -eu
here=$(dirname "$0")
python=$1 wheelhouse=$2 out=$3
stage=$(mktemp -d "${TMPDIR:-/tmp}/cellward-deb.XXXXXX")
trap 'rm -rf "$stage"' EXIT
chmod 755 "$stage"
version=$("$python" -m daemon.service.stage "$stage" "$wheelhouse")
minor=$("$python" -c 'import sys; print("python%d.%d" % sys.version_info[:2])')
mkdir -p "$stage/DEBIAN" "$out"
size=$(du -sk "$stage" | cut -f1)
for file in control preinst postinst prerm postrm; do
    sed "s/@VERSION@/$version/; s/@PYTHON@/$minor/; s/@SIZE@/$size/" "$here/$file" >"$stage/DEBIAN/$file"
    [ "$file" = control ] || chmod 755 "$stage/DEBIAN/$file"
done
dpkg-deb --root-owner-group -Zzstd -z9 --build "$stage" "$out/cellward_${version}_$(dpkg --print-architecture)_$minor.deb"
