//! Text as lines and fields that know where they stand.

use crate::{FormatError, Place};
use percept_geometry::Timestamp;
use std::str::FromStr;

/// The lines of a text, numbered from 1, without their ends (LF or CR LF).
#[derive(Debug, Clone)]
pub(crate) struct Lines<'a> {
    format: &'static str,
    bytes: &'a [u8],
    offset: usize,
    number: u64,
}

/// One line.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Line<'a> {
    pub(crate) format: &'static str,
    pub(crate) number: u64,
    pub(crate) bytes: &'a [u8],
    /// Whether a line end follows; false only for the last line.
    pub(crate) ended: bool,
}

impl<'a> Lines<'a> {
    pub(crate) fn new(format: &'static str, bytes: &'a [u8]) -> Self {
        Self::resume(format, bytes, 0, 0)
    }

    /// Goes on at `offset`, after `number` lines.
    pub(crate) fn resume(format: &'static str, bytes: &'a [u8], offset: usize, number: u64) -> Self {
        Self { format, bytes, offset, number }
    }

    /// Offset of the next line, bytes.
    pub(crate) fn offset(&self) -> usize {
        self.offset
    }

    /// Lines read so far.
    pub(crate) fn number(&self) -> u64 {
        self.number
    }

    /// Lines that are neither blank nor comments (`#`).
    pub(crate) fn contents(self) -> impl Iterator<Item = Line<'a>> {
        self.filter(|line| line.bytes.trim_ascii_start().first().is_some_and(|&b| b != b'#'))
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = Line<'a>;

    fn next(&mut self) -> Option<Line<'a>> {
        let rest = self.bytes.get(self.offset..).filter(|rest| !rest.is_empty())?;
        let end = rest.iter().position(|&b| b == b'\n');
        let line = &rest[..end.unwrap_or(rest.len())];
        self.offset += end.map_or(rest.len(), |end| end + 1);
        self.number += 1;
        let bytes = line.strip_suffix(b"\r").unwrap_or(line);
        Some(Line { format: self.format, number: self.number, bytes, ended: end.is_some() })
    }
}

impl<'a> Line<'a> {
    pub(crate) fn fields(&self) -> Fields<'a> {
        Fields { line: *self, rest: self.bytes }
    }

    pub(crate) fn place(&self) -> Place {
        Place::Line(self.number)
    }

    /// An error about this line.
    pub(crate) fn malformed(&self, field: &str, found: &[u8], expected: &'static str) -> FormatError {
        FormatError::malformed(self.format, self.place(), field, found, expected)
    }

    /// Exactly `N` finite numbers, and nothing more.
    pub(crate) fn numbers<const N: usize>(&self, field: &str) -> Result<[f64; N], FormatError> {
        let mut fields = self.fields();
        let mut out = [0.0; N];
        for value in &mut out {
            *value = fields.finite(field)?;
        }
        fields.end()?;
        Ok(out)
    }
}

/// The whitespace-separated fields of a line.
#[derive(Debug, Clone)]
pub(crate) struct Fields<'a> {
    line: Line<'a>,
    rest: &'a [u8],
}

impl<'a> Fields<'a> {
    /// The next field as it stands, if there is one.
    pub(crate) fn token(&mut self) -> Option<&'a [u8]> {
        let rest = self.rest.trim_ascii_start();
        let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        let (token, rest) = rest.split_at(end);
        self.rest = rest;
        (!token.is_empty()).then_some(token)
    }

    /// The next field as it stands.
    pub(crate) fn required(&mut self, field: &str) -> Result<&'a [u8], FormatError> {
        self.token().ok_or_else(|| self.line.malformed(field, b"end of line", "a value"))
    }

    /// The next field as a number; NaN and infinity pass.
    pub(crate) fn number<T: FromStr>(&mut self, field: &str) -> Result<T, FormatError> {
        let token = self.required(field)?;
        parse(token).ok_or_else(|| self.line.malformed(field, token, "a number"))
    }

    /// The next field as a finite number.
    pub(crate) fn finite(&mut self, field: &str) -> Result<f64, FormatError> {
        let token = self.required(field)?;
        parse::<f64>(token)
            .filter(|v| v.is_finite())
            .ok_or_else(|| self.line.malformed(field, token, "a finite number"))
    }

    /// The next field as seconds, to the nanosecond.
    pub(crate) fn stamp(&mut self, field: &str) -> Result<Timestamp, FormatError> {
        let token = self.required(field)?;
        parse_stamp(token).ok_or_else(|| self.line.malformed(field, token, "seconds"))
    }

    /// Nothing may follow.
    pub(crate) fn end(&mut self) -> Result<(), FormatError> {
        match self.token() {
            None => Ok(()),
            Some(token) => Err(self.line.malformed("row", token, "end of line")),
        }
    }
}

/// A token as a number.
pub(crate) fn parse<T: FromStr>(token: &[u8]) -> Option<T> {
    std::str::from_utf8(token).ok()?.parse().ok()
}

/// Decimal seconds (`1305031102.160407`, `1.4037155e+09`) to nanoseconds without passing through f64,
/// which would lose 200 ns of a stamp of today. Digits beyond the nanosecond are cut off.
pub(crate) fn parse_stamp(token: &[u8]) -> Option<Timestamp> {
    let text = std::str::from_utf8(token).ok()?;
    let (mantissa, exponent) = match text.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().ok().filter(|e| (-1000..=64).contains(e))?),
        None => (text, 0),
    };
    let (negative, digits) = match mantissa.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, mantissa.strip_prefix('+').unwrap_or(mantissa)),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    if whole.len() + fraction.len() == 0 || whole.len() + fraction.len() > 64 {
        return None;
    }
    // The value is 0.d1 d2 d3 … times 10^point: nanoseconds take the digits up to point + 9.
    let point = whole.len() as i32 + exponent + 9;
    let mut nanos: i128 = 0;
    let mut kept = 0;
    for (i, c) in whole.chars().chain(fraction.chars()).enumerate() {
        let digit = i128::from(c.to_digit(10)?);
        if (i as i32) < point {
            nanos = nanos.checked_mul(10)?.checked_add(digit)?;
            kept += 1;
        }
    }
    if nanos != 0 {
        for _ in kept..point {
            nanos = nanos.checked_mul(10)?;
        }
    }
    i64::try_from(if negative { -nanos } else { nanos }).ok().map(Timestamp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn stamps_keep_every_nanosecond() {
        let ns = |text: &str| parse_stamp(text.as_bytes()).map(|t| t.0);
        assert_eq!(ns("1305031102.160407"), Some(1_305_031_102_160_407_000));
        assert_eq!(ns("1.403715529112143517e+09"), Some(1_403_715_529_112_143_517));
        assert_eq!(ns("1.037359e-01"), Some(103_735_900));
        assert_eq!(ns("-0.5"), Some(-500_000_000));
        assert_eq!(ns("0"), Some(0));
        assert_eq!(ns("0e60"), Some(0));
        assert_eq!(ns("1.65576e-153"), Some(0));
        for bad in ["", ".", "-", "nan", "inf", "1e99", "1e30", "1.2.3", "0x10", "12 "] {
            assert_eq!(ns(bad), None, "{bad}");
        }
    }

    proptest! {
        #[test]
        fn a_printed_stamp_reads_back(nanos in any::<i64>()) {
            let stamp = Timestamp(nanos);
            prop_assert_eq!(parse_stamp(stamp.to_string().as_bytes()), Some(stamp));
        }
    }

    #[test]
    fn lines_are_numbered_and_comments_skipped() {
        let lines: Vec<_> = Lines::new("test", b"# a\r\n\n 1 2\r\nx").contents().collect();
        assert_eq!(
            lines.iter().map(|l| (l.number, l.bytes, l.ended)).collect::<Vec<_>>(),
            [(3, b" 1 2".as_slice(), true), (4, b"x".as_slice(), false)]
        );
    }
}
