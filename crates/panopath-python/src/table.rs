//! Comma-separated text to columns, fast. What a column means is decided in Python, which hands over one role a column.
use std::cmp::Ordering;
use std::collections::HashMap;

use csv::ByteRecord;
use numpy::{IntoPyArray, PyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyList, PyTuple};

/// What to do with a column.
#[derive(Clone, Copy, PartialEq)]
enum Role {
    /// A name: blanks around it do not count, and it may not be empty.
    Name,
    /// A name, or nothing, which is the empty name.
    OptionalName,
    /// A finite number.
    Number,
    /// A finite number, or nothing, which becomes NaN.
    Optional,
    /// Not read.
    Skip,
}

impl Role {
    fn parse(text: &str) -> Option<Self> {
        match text {
            "name" => Some(Self::Name),
            "optional_name" => Some(Self::OptionalName),
            "number" => Some(Self::Number),
            "optional" => Some(Self::Optional),
            "skip" => Some(Self::Skip),
            _ => None,
        }
    }
}

/// A column that was read.
enum Column {
    Names(Vec<i32>, Vec<String>),
    Numbers(Vec<f64>),
    Skipped,
}

/// Names met so far, numbered by first appearance.
#[derive(Default)]
struct Names {
    code_of: HashMap<Vec<u8>, i32>,
    codes: Vec<i32>,
    names: Vec<String>,
}

/// Adds this file's functions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(read_table, module)?)?;
    module.add_function(wrap_pyfunction!(read_numbers, module)?)?;
    module.add_function(wrap_pyfunction!(natural_order, module)?)?;
    Ok(())
}

/// Reads comma-separated `data` whose first record is a header, one role a column: "name", "optional_name",
/// "number", "optional" (a number) or "skip". Returns the columns, `(codes, names)` for names in natural order, and the line each row begins on.
#[pyfunction]
pub fn read_table<'py>(
    py: Python<'py>,
    data: &[u8],
    source: &str,
    roles: Vec<String>,
) -> PyResult<(Bound<'py, PyList>, Bound<'py, PyArray1<i64>>)> {
    let parsed: Option<Vec<Role>> = roles.iter().map(|role| Role::parse(role)).collect();
    let parsed = parsed.ok_or_else(|| PyValueError::new_err("unknown role of a column"))?;
    let (columns, lines) =
        py.detach(|| read(data, &parsed)).map_err(|error| PyValueError::new_err(format!("{source}: {error}")))?;
    let list = PyList::empty(py);
    for column in columns {
        match column {
            Column::Numbers(values) => list.append(values.into_pyarray(py))?,
            Column::Names(codes, names) => {
                let pair = (codes.into_pyarray(py), PyList::new(py, names)?);
                list.append(PyTuple::new(py, [pair.0.into_any(), pair.1.into_any()])?)?;
            }
            Column::Skipped => list.append(py.None())?,
        }
    }
    Ok((list, lines.into_pyarray(py)))
}

fn read(data: &[u8], roles: &[Role]) -> Result<(Vec<Column>, Vec<i64>), String> {
    let mut reader = csv::ReaderBuilder::new().has_headers(true).flexible(true).from_reader(data);
    let header: Vec<String> = match reader.byte_headers() {
        Ok(fields) => fields.iter().map(|field| String::from_utf8_lossy(field).trim().to_owned()).collect(),
        Err(error) => return Err(error.to_string()),
    };
    if header.len() != roles.len() {
        return Err(format!("line 1: {} columns, expected {}", header.len(), roles.len()));
    }
    let expected_rows = data.len() / (8 * roles.len());
    let mut lines: Vec<i64> = Vec::with_capacity(expected_rows);
    let mut numbers: Vec<Vec<f64>> = roles.iter().map(|_| Vec::new()).collect();
    let mut names: Vec<Names> = roles.iter().map(|_| Names::default()).collect();
    let mut counter = LineCounter { data, at: 0, line: 1 };
    let mut record = ByteRecord::new();
    while reader.read_byte_record(&mut record).map_err(|error| error.to_string())? {
        let line = counter.line_of(record.position().map_or(0, |position| position.byte() as usize));
        if record.len() != roles.len() {
            return Err(wrong_width(line, &record, &header));
        }
        for (c, field) in record.iter().enumerate() {
            let wrong = |what: &str| format!("line {line}, column {}: {}, expected {what}", header[c], shown(field));
            match roles[c] {
                Role::Skip => {}
                Role::Name if field.trim_ascii().is_empty() => return Err(wrong("a name")),
                Role::Name | Role::OptionalName => names[c].push(field, &wrong)?,
                Role::Number => numbers[c].push(number(field).ok_or_else(|| wrong("a finite number"))?),
                Role::Optional if field.trim_ascii().is_empty() => numbers[c].push(f64::NAN),
                Role::Optional => {
                    numbers[c].push(number(field).ok_or_else(|| wrong("a finite number or nothing"))?);
                }
            }
        }
        lines.push(line);
    }
    let columns = roles.iter().zip(names.into_iter().zip(numbers)).map(|(role, (names, numbers))| match role {
        Role::Skip => Column::Skipped,
        Role::Name | Role::OptionalName => names.in_natural_order(),
        Role::Number | Role::Optional => Column::Numbers(numbers),
    });
    Ok((columns.collect(), lines))
}

/// Turns the byte where a record begins into its line, walking the data once.
struct LineCounter<'a> {
    data: &'a [u8],
    at: usize,
    line: i64,
}

impl LineCounter<'_> {
    fn line_of(&mut self, begin: usize) -> i64 {
        let mut begin = begin.min(self.data.len());
        // the reader counts the empty lines before a record, and the second half of \r\n, to the record
        while begin < self.data.len() && matches!(self.data[begin], b'\n' | b'\r') {
            begin += 1;
        }
        let passed = self.data.get(self.at..begin).unwrap_or_default();
        self.line += passed.iter().filter(|&&byte| byte == b'\n').count() as i64;
        self.at = begin.max(self.at);
        self.line
    }
}

fn wrong_width(line: i64, record: &ByteRecord, header: &[String]) -> String {
    let missing = header.get(record.len()).map_or(String::new(), |name| format!(" (column {name} is missing)"));
    format!("line {line}: {} fields{missing}, expected {}: {}", record.len(), header.len(), header.join(","))
}

/// A field as an error message shows it: quoted, escaped, and not too long.
fn shown(field: &[u8]) -> String {
    let text = String::from_utf8_lossy(field);
    let text = text.trim();
    if text.is_empty() {
        return "empty".to_owned();
    }
    let mut short: String = text.chars().take(40).collect();
    if short.len() < text.len() {
        short.push_str("...");
    }
    format!("found {short:?}")
}

fn number(field: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(field).ok()?.trim();
    text.parse::<f64>().ok().filter(|value| value.is_finite())
}

impl Names {
    fn push(&mut self, field: &[u8], wrong: &dyn Fn(&str) -> String) -> Result<(), String> {
        let key = field.trim_ascii();
        if let Some(&code) = self.code_of.get(key) {
            self.codes.push(code);
            return Ok(());
        }
        let name = std::str::from_utf8(key).map_err(|_| wrong("UTF-8 text"))?;
        let code = i32::try_from(self.names.len()).map_err(|_| wrong("fewer than 2^31 names"))?;
        self.code_of.insert(key.to_vec(), code);
        self.names.push(name.to_owned());
        self.codes.push(code);
        Ok(())
    }

    /// Renumbers names in natural order, so that the numbering does not depend on the order of the rows.
    fn in_natural_order(mut self) -> Column {
        let mut order: Vec<usize> = (0..self.names.len()).collect();
        order.sort_unstable_by(|&a, &b| natural(&self.names[a], &self.names[b]));
        let mut rank = vec![0_i32; order.len()];
        for (position, &code) in order.iter().enumerate() {
            rank[code] = position as i32;
        }
        for code in &mut self.codes {
            *code = rank[*code as usize];
        }
        let names = order.iter().map(|&code| std::mem::take(&mut self.names[code])).collect();
        Column::Names(self.codes, names)
    }
}

/// The order in which a person would sort `names`: the indices, first to last.
#[pyfunction]
pub fn natural_order(py: Python<'_>, names: Vec<String>) -> Bound<'_, PyArray1<i64>> {
    let mut order: Vec<i64> = (0..names.len() as i64).collect();
    order.sort_by(|&a, &b| natural(&names[a as usize], &names[b as usize]));
    order.into_pyarray(py)
}

/// Reads numbers set apart by blanks and line ends, `skip_lines` lines down.
#[pyfunction]
pub fn read_numbers<'py>(
    py: Python<'py>,
    data: &[u8],
    source: &str,
    skip_lines: usize,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let values = py
        .detach(|| numbers_in(data, skip_lines))
        .map_err(|error| PyValueError::new_err(format!("{source}: {error}")))?;
    Ok(values.into_pyarray(py))
}

fn numbers_in(data: &[u8], skip_lines: usize) -> Result<Vec<f64>, String> {
    let mut values = Vec::with_capacity(data.len() / 8);
    for (index, line) in data.split(|&byte| byte == b'\n').enumerate().skip(skip_lines) {
        let fields = line.split(u8::is_ascii_whitespace).filter(|field| !field.is_empty());
        for (place, field) in fields.enumerate() {
            let wrong =
                || format!("line {}, field {}: {}, expected a finite number", index + 1, place + 1, shown(field));
            values.push(number(field).ok_or_else(wrong)?);
        }
    }
    Ok(values)
}

/// Compares as a person sorts: runs of digits by value ("view2" before "view10"), the rest by bytes; ties by bytes.
fn natural(a: &str, b: &str) -> Ordering {
    let (mut x, mut y) = (a.as_bytes(), b.as_bytes());
    while let (Some(p), Some(q)) = (x.first(), y.first()) {
        if p.is_ascii_digit() && q.is_ascii_digit() {
            let (first, second) = (digits(&mut x), digits(&mut y));
            let order = first.len().cmp(&second.len()).then_with(|| first.cmp(second));
            if order != Ordering::Equal {
                return order;
            }
        } else if p == q {
            (x, y) = (&x[1..], &y[1..]);
        } else {
            return p.cmp(q);
        }
    }
    x.len().cmp(&y.len()).then_with(|| a.cmp(b))
}

/// Takes a run of digits off the front, without its leading zeros.
fn digits<'a>(text: &mut &'a [u8]) -> &'a [u8] {
    let end = text.iter().position(|byte| !byte.is_ascii_digit()).unwrap_or(text.len());
    let (run, rest) = text.split_at(end);
    *text = rest;
    let zeros = run.iter().position(|&byte| byte != b'0').unwrap_or(run.len());
    &run[zeros..]
}
