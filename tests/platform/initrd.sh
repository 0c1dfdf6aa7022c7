#!/bin/bash
# Sourced by vm.sh and guest.sh: the small file system in which a virtual machine's kernel finds its modules.

# make_initrd OUT MODULE... <INIT: packs busybox, the modules (.ko or .ko.xz, in the order of their loading) and the
# machine's first program, which loads them and then goes on with INIT.
make_initrd() {
	local out=$1 module n=10 tree
	shift
	tree=$(mktemp -d)
	mkdir -p "$tree"/{bin,dev,proc,root,m}
	cp "$(command -v busybox)" "$tree/bin/"
	for module; do
		xz -dc "$module" >"$tree/m/$n.ko" 2>/dev/null || cp "$module" "$tree/m/$n.ko"
		n=$((n + 1))
	done
	{
		cat <<-'I'
			#!/bin/busybox sh
			/bin/busybox mount -t proc proc /proc
			/bin/busybox mount -t devtmpfs dev /dev
			for m in /m/*.ko; do /bin/busybox insmod "$m" 2>/dev/null; done
		I
		cat
	} >"$tree/init"
	chmod +x "$tree/init"
	(cd "$tree" && find . | cpio --quiet -o -H newc | gzip -1) >"$out.part"
	mv "$out.part" "$out"
	rm -rf --one-file-system "$tree"
}
