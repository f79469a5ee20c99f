//! Tables in Parquet: named and typed columns whose cells may be missing, written in pieces so that a table may be
//! larger than memory. Compressed with Zstandard.

use crate::atomic_file::NewFile;
use parquet::basic::{Compression, ConvertedType, Repetition, Type as Physical, ZstdLevel};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::Type;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Why a table cannot be written.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TableError {
    /// The file system reports an error.
    #[error("{}: cannot be written: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    /// The library reports an error.
    #[error("{}: cannot be written: {source}", path.display())]
    Parquet { path: PathBuf, source: ParquetError },
}

/// Cells of a column.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Cells {
    Text(Vec<Option<String>>),
    Whole(Vec<Option<i64>>),
    Real(Vec<Option<f64>>),
    Flag(Vec<Option<bool>>),
}

impl Cells {
    fn physical(&self) -> Physical {
        match self {
            Self::Text(_) => Physical::BYTE_ARRAY,
            Self::Whole(_) => Physical::INT64,
            Self::Real(_) => Physical::DOUBLE,
            Self::Flag(_) => Physical::BOOLEAN,
        }
    }

    fn write(&self, group: &mut SerializedRowGroupWriter<'_, BufWriter<File>>) -> Result<(), ParquetError> {
        match self {
            Self::Text(cells) => {
                column::<ByteArrayType, _>(group, cells, |text: &String| ByteArray::from(text.as_str()))
            }
            Self::Whole(cells) => column::<Int64Type, _>(group, cells, |number| *number),
            Self::Real(cells) => column::<DoubleType, _>(group, cells, |number| *number),
            Self::Flag(cells) => column::<BoolType, _>(group, cells, |flag| *flag),
        }
    }
}

fn column<D: DataType, T>(
    group: &mut SerializedRowGroupWriter<'_, BufWriter<File>>,
    cells: &[Option<T>],
    value: impl Fn(&T) -> D::T,
) -> Result<(), ParquetError> {
    let Some(mut writer) = group.next_column()? else {
        return Err(ParquetError::General("a table with more columns than it was begun with".to_owned()));
    };
    let there: Vec<i16> = cells.iter().map(|cell| i16::from(cell.is_some())).collect();
    let values: Vec<D::T> = cells.iter().flatten().map(value).collect();
    writer.typed::<D>().write_batch(&values, Some(&there), None)?;
    writer.close()
}

/// A table being written. It appears in its place only when [finished](Table::finish).
pub(crate) struct Table {
    place: PathBuf,
    new: NewFile,
    writer: SerializedFileWriter<BufWriter<File>>,
}

impl Table {
    /// Begins a table with these columns; only the kind of the cells matters.
    ///
    /// # Errors
    /// [`TableError`].
    pub(crate) fn begin(place: &Path, columns: &[(String, Cells)]) -> Result<Self, TableError> {
        let (new, file) = NewFile::begin(place).map_err(|source| TableError::Io { path: place.to_owned(), source })?;
        let writer = || {
            let mut fields = Vec::new();
            for (name, cells) in columns {
                let field = Type::primitive_type_builder(name, cells.physical()).with_repetition(Repetition::OPTIONAL);
                let text = matches!(cells, Cells::Text(_));
                let field = if text { field.with_converted_type(ConvertedType::UTF8) } else { field };
                fields.push(Arc::new(field.build()?));
            }
            let schema = Arc::new(Type::group_type_builder("schema").with_fields(fields).build()?);
            let properties = WriterProperties::builder()
                .set_compression(Compression::ZSTD(ZstdLevel::try_new(3)?))
                .set_created_by(format!("catoptra {}", env!("CARGO_PKG_VERSION")))
                .build();
            SerializedFileWriter::new(BufWriter::new(file), schema, Arc::new(properties))
        };
        match writer() {
            Ok(writer) => Ok(Self { place: place.to_owned(), new, writer }),
            Err(source) => Err(TableError::Parquet { path: place.to_owned(), source }),
        }
    }

    /// Adds rows: all columns, in the order they were begun with.
    ///
    /// # Errors
    /// [`TableError`].
    pub(crate) fn add(&mut self, columns: &[(String, Cells)]) -> Result<(), TableError> {
        let mut add = || -> Result<(), ParquetError> {
            let mut group = self.writer.next_row_group()?;
            columns.iter().try_for_each(|(_, cells)| cells.write(&mut group))?;
            group.close().map(drop)
        };
        add().map_err(|source| TableError::Parquet { path: self.place.clone(), source })
    }

    /// Completes the file, which is beside its place until it is put there.
    ///
    /// # Errors
    /// [`TableError`].
    pub(crate) fn complete(self) -> Result<NewFile, TableError> {
        let Self { place, new, writer } = self;
        let io = |source| TableError::Io { path: place.clone(), source };
        let buffer = writer.into_inner().map_err(|source| TableError::Parquet { path: place.clone(), source })?;
        let file = buffer.into_inner().map_err(|error| io(error.into_error()))?;
        file.sync_all().map_err(io)?;
        Ok(new)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use parquet::file::reader::SerializedFileReader;
    use parquet::record::RowAccessor as _;

    fn piece(from: i64) -> Vec<(String, Cells)> {
        vec![
            ("name".to_owned(), Cells::Text(vec![Some("a".to_owned()), None, Some("é".to_owned())])),
            ("seq".to_owned(), Cells::Whole(vec![Some(from), Some(from + 1), None])),
            ("theta_deg".to_owned(), Cells::Real(vec![None, Some(-1.25), Some(f64::MAX)])),
            ("retryable".to_owned(), Cells::Flag(vec![Some(true), None, Some(false)])),
        ]
    }

    #[test]
    fn what_was_written_is_read() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("table.parquet");
        let mut table = Table::begin(&path, &piece(0)).unwrap();
        table.add(&piece(0)).unwrap();
        table.add(&piece(7)).unwrap();
        assert!(!path.exists());
        table.complete().unwrap().put_in_place().unwrap();
        let rows: Vec<_> =
            SerializedFileReader::new(File::open(&path).unwrap()).unwrap().into_iter().map(Result::unwrap).collect();
        assert_eq!(rows.len(), 6);
        assert_eq!((rows[3].get_string(0).unwrap().as_str(), rows[3].get_long(1).unwrap()), ("a", 7));
        assert!(rows[1].get_string(0).is_err() && rows[2].get_long(1).is_err());
        assert_eq!((rows[5].get_double(2).unwrap(), rows[5].get_bool(3).unwrap()), (f64::MAX, false));
    }

    #[test]
    fn a_table_that_is_not_finished_leaves_nothing() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("table.parquet");
        drop(Table::begin(&path, &piece(0)).unwrap());
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 0);
        assert!(Table::begin(&place.path().join("none/table.parquet"), &piece(0)).is_err());
    }
}
