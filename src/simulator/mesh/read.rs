//! The bytes of STL and OBJ files as triangles.

use glam::DVec3;

use super::{Error, MAX_TRIANGLES, Triangle, corners};

/// Bytes before a binary STL's triangles: 80 that say nothing, and their number.
const HEAD: usize = 84;
/// Bytes of a triangle: a normal, three corners, two bytes of no meaning.
const RECORD: usize = 50;
/// Most vertices of an OBJ file: as many as triangles that share none have.
const MAX_VERTICES: usize = 3 * MAX_TRIANGLES;

/// A binary STL if its length is as its header says, whatever that begins with; else text.
pub fn stl(bytes: &[u8]) -> Result<Vec<Triangle>, Error> {
    let count = bytes.get(HEAD - 4..HEAD).and_then(|count| count.try_into().ok());
    let count = count.map(u32::from_le_bytes);
    let expected = count.map(|n| HEAD as u64 + u64::from(n) * RECORD as u64);
    let got = bytes.len() as u64;
    let is_text = !bytes.is_empty() && !bytes.iter().take(1024).any(|&b| b == 0);
    match (count, expected) {
        // Some programs write something after the triangles.
        (Some(_), Some(expected)) if expected == got || expected < got && !is_text => binary(bytes),
        _ if is_text => ascii(bytes),
        (Some(triangles), Some(expected)) => Err(Error::CutOff { triangles, expected, got }),
        _ => Err(Error::NotStl(match got {
            0 => "an empty file".into(),
            _ => format!("{got} bytes that are no text"),
        })),
    }
}

fn binary(bytes: &[u8]) -> Result<Vec<Triangle>, Error> {
    let (head, rest) = bytes.split_at(HEAD);
    let count = u32::from_le_bytes([head[80], head[81], head[82], head[83]]) as usize;
    check(count, MAX_TRIANGLES, "triangles")?;
    let float = |bytes: &[u8]| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let records = rest.chunks_exact(RECORD).take(count);
    let corner =
        |record: &[u8], at: usize| [0, 4, 8].map(|part| float(&record[12 * (at + 1) + part..]));
    Ok(records.map(|record| [0, 1, 2].map(|at| corner(record, at))).collect())
}

fn ascii(bytes: &[u8]) -> Result<Vec<Triangle>, Error> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut triangles = Vec::new();
    let mut facet = Vec::with_capacity(3);
    let (mut is_open, mut last) = (false, 0);
    for (line, words) in lines(bytes) {
        let Some(word) = words.clone().next() else { continue };
        let fail = |expected: &str| Err(wrong(line, expected, words.clone()));
        let expected = if facet.is_empty() { "a facet or endsolid" } else { "three vertices" };
        last = line;
        match word.to_ascii_lowercase().as_slice() {
            b"solid" if facet.is_empty() => is_open = true,
            _ if !is_open && triangles.is_empty() => {
                return Err(Error::NotStl(format!("text that begins with \"{}\"", shown(words))));
            }
            b"facet" | b"outer" if facet.is_empty() => {}
            b"vertex" if facet.len() < 3 => facet.push(position(line, words)?),
            b"endloop" if facet.len() == 3 => {}
            b"endfacet" => match <[_; 3]>::try_from(facet.as_slice()) {
                Ok(triangle) => {
                    check(triangles.len() + 1, MAX_TRIANGLES, "triangles")?;
                    triangles.push(triangle);
                    facet.clear();
                }
                Err(_) => return fail("endfacet after three vertices"),
            },
            b"endsolid" if facet.is_empty() => is_open = false,
            _ => return fail(expected),
        }
    }
    match is_open {
        true => Err(Error::Line {
            line: last,
            expected: "endsolid at the end".into(),
            got: format!("the file's end after {} triangles: it was cut off", triangles.len()),
        }),
        false if last == 0 => Err(Error::NotStl("an empty text".into())),
        false => Ok(triangles),
    }
}

/// The faces of an OBJ file. A face of more than three corners must be convex.
pub fn obj(bytes: &[u8]) -> Result<Vec<Triangle>, Error> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for (line, words) in lines(bytes) {
        let mut rest = words.clone();
        match rest.next() {
            Some(b"v") => {
                check(vertices.len() + 1, MAX_VERTICES, "vertices")?;
                vertices.push(position(line, words)?);
            }
            Some(b"f") => {
                let mut face = Vec::with_capacity(4);
                for word in rest {
                    let Some(at) = index(word, vertices.len()) else {
                        let expected = format!("vertices of the {} so far", vertices.len());
                        return Err(wrong(line, &expected, words));
                    };
                    check(triangles.len() + face.len(), MAX_TRIANGLES, "triangles")?;
                    face.push(vertices[at]);
                }
                let fan = face.windows(2).skip(1).map(|pair| [face[0], pair[0], pair[1]]);
                match face.len() {
                    0..3 => return Err(wrong(line, "at least three corners", words)),
                    3 => {}
                    _ if is_convex(&face) => {}
                    _ => return Err(wrong(line, "triangles or convex faces", words)),
                }
                triangles.extend(fan);
            }
            _ => {}
        }
    }
    Ok(triangles)
}

/// Place of the vertex that a face's word names: counted from 1, or backwards from −1. Texture and normal
/// follow after slashes.
fn index(word: &[u8], count: usize) -> Option<usize> {
    let number = word.split(|&b| b == b'/').next()?;
    let number: i64 = std::str::from_utf8(number).ok()?.parse().ok()?;
    let at = if number < 0 { number.checked_add(count as i64)? } else { number - 1 };
    usize::try_from(at).ok().filter(|&at| at < count)
}

/// Whether triangles from its first corner fill a face: none of them is turned against the whole.
fn is_convex(face: &[[f32; 3]]) -> bool {
    let normal = |pair: &[[f32; 3]]| {
        let [a, b, c] = corners(&[face[0], pair[0], pair[1]]);
        (b - a).cross(c - a)
    };
    let all: DVec3 = face.windows(2).skip(1).map(normal).sum();
    // Corners on a straight line may be off it by what single precision rounds.
    let least = -1e-5 * all.length_squared();
    face.windows(2).skip(1).all(|pair| normal(pair).dot(all) >= least)
}

type Words<'a> = std::iter::Filter<std::slice::Split<'a, u8, fn(&u8) -> bool>, fn(&&[u8]) -> bool>;

/// Each line's number, from 1, and its words.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, Words<'_>)> {
    let is_space: fn(&u8) -> bool = u8::is_ascii_whitespace;
    let is_word: fn(&&[u8]) -> bool = |word| !word.is_empty();
    let lines = bytes.split(|&b| b == b'\n').zip(1..);
    lines.map(move |(line, number)| (number, line.split(is_space).filter(is_word)))
}

/// The three numbers after a line's first word.
fn position(line: usize, words: Words) -> Result<[f32; 3], Error> {
    let mut numbers =
        words.clone().skip(1).map(|word| std::str::from_utf8(word).ok()?.parse().ok());
    let mut next = || numbers.next().flatten();
    match (next(), next(), next()) {
        (Some(x), Some(y), Some(z)) => Ok([x, y, z]),
        _ => Err(wrong(line, "three numbers", words)),
    }
}

fn wrong(line: usize, expected: &str, words: Words) -> Error {
    Error::Line { line, expected: expected.into(), got: format!("\"{}\"", shown(words)) }
}

/// A line's beginning, fit to be shown.
fn shown(words: Words) -> String {
    let words: Vec<_> = words.take(8).map(String::from_utf8_lossy).collect();
    let line = words.join(" ");
    let clean = line.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c });
    let mut clean: String = clean.take(41).collect();
    if let Some((end, _)) = clean.char_indices().nth(40) {
        clean.truncate(end);
        clean.push('…');
    }
    clean
}

fn check(count: usize, most: usize, what: &'static str) -> Result<(), Error> {
    if count <= most { Ok(()) } else { Err(Error::TooMany { what, most }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: Triangle = [[0.0, 0.5, 1.0], [10.0, 0.0, 0.0], [0.0, 10.0, -2.5]];

    fn record(triangle: &Triangle) -> Vec<u8> {
        let floats = [0f32; 3].iter().chain(triangle.as_flattened());
        let mut bytes: Vec<u8> = floats.flat_map(|v| v.to_le_bytes()).collect();
        bytes.extend([0, 0]);
        bytes
    }

    /// A binary STL whose header begins with this.
    fn binary_stl(header: &str, triangles: &[Triangle]) -> Vec<u8> {
        let mut bytes = vec![0; 80];
        bytes[..header.len()].copy_from_slice(header.as_bytes());
        bytes.extend((triangles.len() as u32).to_le_bytes());
        bytes.extend(triangles.iter().flat_map(record));
        bytes
    }

    const TEXT: &str = "solid\r
        facet normal 0 0 0\r
         outer loop\r
          vertex 0 5e-1 1\r
          VERTEX 10 0 0\r
          vertex 0 +10 -2.5\r
         endloop\r
        endfacet\r
    endsolid\r
    ";

    #[test]
    fn both_kinds_of_stl_are_read() {
        for header in ["", "solid from a program that says so", &"s".repeat(80)] {
            let bytes = binary_stl(header, &[TRIANGLE; 3]);
            assert_eq!(stl(&bytes).expect(header), [TRIANGLE; 3]);
            let longer = [&bytes[..], b"a comment"].concat();
            assert_eq!(stl(&longer).expect("a binary STL")[..], [TRIANGLE; 3][..]);
        }
        assert_eq!(stl(TEXT.as_bytes()).expect("text"), [TRIANGLE]);
        let twice = format!("\u{feff}{TEXT}{}", TEXT.replacen("solid", "solid facet é", 1));
        assert_eq!(stl(twice.as_bytes()).expect("two solids"), [TRIANGLE; 2]);
        assert!(stl(b"solid none\nendsolid none").expect("no triangles").is_empty());
    }

    #[test]
    fn what_is_no_stl_is_named() {
        let cut = |text: &str| TEXT[..TEXT.find(text).expect("in it")].to_owned();
        let bytes = binary_stl("", &[TRIANGLE; 3]);
        let swapped = |from, to| TEXT.replacen(from, to, 1).into_bytes();
        let cases: &[(Vec<u8>, &str)] = &[
            (vec![], "expected an STL file, got an empty file"),
            (b" \n\n".to_vec(), "expected an STL file, got an empty text"),
            (
                b"Dear all,\nas agreed".to_vec(),
                "expected an STL file, got text that begins with \"Dear all,\"",
            ),
            (vec![0; 50], "expected an STL file, got 50 bytes that are no text"),
            (
                bytes[..200].to_vec(),
                "expected a binary STL of 3 triangles as its header says, 234 bytes; got 200 bytes: it was cut off, or is no STL",
            ),
            (
                cut("endsolid").into(),
                "line 8: expected endsolid at the end, got the file's end after 1 triangles: it was cut off",
            ),
            (
                cut("endloop").into(),
                "line 6: expected endsolid at the end, got the file's end after 0 triangles: it was cut off",
            ),
            (swapped("10 0 0", "10 0"), "line 5: expected three numbers, got \"VERTEX 10 0\""),
            (
                swapped("10 0 0", "10 0 0,5"),
                "line 5: expected three numbers, got \"VERTEX 10 0 0,5\"",
            ),
            (
                swapped("VERTEX 10 0 0", "endloop"),
                "line 5: expected three vertices, got \"endloop\"",
            ),
            (
                swapped("endloop", "vertex 1 2 3"),
                "line 7: expected three vertices, got \"vertex 1 2 3\"",
            ),
            (
                swapped("facet", "\u{7}facette"),
                "line 2: expected a facet or endsolid, got \"\u{fffd}facette normal 0 0 0\"",
            ),
        ];
        for (bytes, expected) in cases {
            let got = stl(bytes).expect_err(expected).to_string();
            assert_eq!(&got, expected);
        }
        let mut many = vec![0; 84];
        many[80..].copy_from_slice(&(1_000_001u32).to_le_bytes());
        many.resize(84 + 50 * 1_000_001, 0);
        assert!(matches!(stl(&many), Err(Error::TooMany { .. })));
    }

    #[test]
    fn obj_faces_are_cut_into_triangles() {
        let text = "# a square and its half\nmtllib x.mtl\nv 0 0 0\nv 2 0 0 1 0 0\nv 2 2 0\nv 0 2 0 1.0\n\
                    vn 0 0 1\no part\nf 1//1 2//1 3//9223372036854775807 4\nf -4/1 -3/2 -2\nl 1 2\n";
        let [a, b, c, d] = [[0.0; 3], [2.0, 0.0, 0.0], [2.0, 2.0, 0.0], [0.0, 2.0, 0.0]];
        assert_eq!(obj(text.as_bytes()).expect("faces"), [[a, b, c], [a, c, d], [a, b, c]]);
        assert!(obj(b"").expect("nothing").is_empty());
    }

    #[test]
    fn what_is_no_obj_is_named() {
        let dart = "v 0 0 0\nv 2 -1 0\nv 1 0 0\nv 2 1 0\n";
        let cases = [
            ("v 1 2\n".to_owned(), "line 1: expected three numbers, got \"v 1 2\""),
            ("\nf 1 2 3".into(), "line 2: expected vertices of the 0 so far, got \"f 1 2 3\""),
            (
                format!("{dart}f 0 1 2"),
                "line 5: expected vertices of the 4 so far, got \"f 0 1 2\"",
            ),
            (
                format!("{dart}f 1 2 5"),
                "line 5: expected vertices of the 4 so far, got \"f 1 2 5\"",
            ),
            (
                format!("{dart}f -9223372036854775808 1 2"),
                "line 5: expected vertices of the 4 so far, got \"f -9223372036854775808 1 2\"",
            ),
            (
                format!("{dart}f 1 x 2"),
                "line 5: expected vertices of the 4 so far, got \"f 1 x 2\"",
            ),
            (format!("{dart}f 1 2"), "line 5: expected at least three corners, got \"f 1 2\""),
            (
                format!("{dart}f 2 3 4 1"),
                "line 5: expected triangles or convex faces, got \"f 2 3 4 1\"",
            ),
        ];
        for (text, expected) in cases {
            assert_eq!(obj(text.as_bytes()).expect_err(expected).to_string(), expected);
        }
    }

    /// Whatever the bytes, there are triangles or an error.
    #[test]
    fn changed_bytes_are_no_panic() {
        let sources =
            [binary_stl("solid", &[TRIANGLE; 4]), TEXT.into(), b"v 0 0 0\nf 1 1/2 -1\n".to_vec()];
        let mut state = 1u64;
        let mut random = move |below: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 33) as usize % below
        };
        for source in sources {
            for _ in 0..3000 {
                let mut bytes = source.clone();
                for _ in 0..1 + random(4) {
                    let at = random(bytes.len());
                    bytes[at] = random(256) as u8;
                }
                bytes.truncate(1 + random(bytes.len()));
                let _ = (stl(&bytes), obj(&bytes));
            }
        }
    }
}
