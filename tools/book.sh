#!/usr/bin/env bash
# Builds the documentation as a web site, target/book/index.html, and mdBook where it is not built yet. Fails where
# mdBook warns and where a link leads nowhere. Needs Rust and Perl.
set -euo pipefail
cd "$(dirname "$0")/.."

target=${CARGO_TARGET_DIR:-target}
version=0.5.4
mdbook=$target/tools/bin/mdbook
if [ "$("$mdbook" --version 2>/dev/null)" != "mdbook v$version" ]; then
    # Unoptimised it is built in half the time, and the book still in 2 s.
    CARGO_PROFILE_DEV_DEBUG=0 cargo install --debug --quiet --locked --no-default-features --version "$version" \
        --root "$target/tools" mdbook
fi
book=$PWD/target/book
said=$("$mdbook" build --dest-dir "$book" 2>&1) || {
    echo "$said"
    exit 1
}
if grep -E "WARN|ERROR" <<<"$said"; then
    exit 1
fi

# What the repository has beside its documentation is not part of the site: its name stays, its link goes. mdBook calls
# a README index, but not in links.
beside='(?:\.\./)+(?:bindings|src|tests|tools|weights)/'
find "$book" -name '*.html' -exec \
    perl -0pi -e "s{<a href=\"$beside[^\"]*\">(.*?)</a>}{\$1}gs; s{README\.html}{index.html}g" {} +

pages=0
dead=0
while read -r page; do
    pages=$((pages + 1))
    while read -r link; do
        if [ ! -e "$(dirname "$page")/$link" ]; then
            echo "${page#"$book"/}: expected a file, got nothing at $link"
            dead=$((dead + 1))
        fi
    done < <(perl -ne 'print "$2\n" while /\b(href|src)="(?!\w+:|#)([^"#?]+)/g' "$page" | sort -u)
done < <(find "$book" -name '*.html' ! -name 404.html ! -name toc.html)
echo "$pages pages in target/book, $dead dead links"
[ "$dead" -eq 0 ]
