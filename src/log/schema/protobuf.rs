//! The Protobuf package of the project's own messages.

use foxglove::bytes::BufMut;
use foxglove::prost_types::{FileDescriptorProto, FileDescriptorSet};
use foxglove::protobuf::{ProtobufField, prost_file_descriptor_set_to_vec};
use foxglove::{Encode, Schema};
use std::collections::HashSet;

/// `M` as a message of the Protobuf package `catoptra` (the derived schema would name a package after the type).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Catoptra<M>(pub(crate) M);

impl<M: Encode + ProtobufField> Encode for Catoptra<M> {
    type Error = M::Error;

    fn get_schema() -> Option<Schema> {
        let name = M::type_name()?;
        let mut seen = HashSet::new();
        let mut files: Vec<FileDescriptorProto> = M::file_descriptors();
        files.retain(|file| seen.insert(file.name.clone()));
        files.push(FileDescriptorProto {
            name: Some(format!("catoptra/{name}.proto")),
            package: Some("catoptra".to_owned()),
            syntax: Some("proto3".to_owned()),
            dependency: files.iter().filter_map(|file| file.name.clone()).collect(),
            message_type: M::message_descriptor().into_iter().collect(),
            ..FileDescriptorProto::default()
        });
        let bytes = prost_file_descriptor_set_to_vec(&FileDescriptorSet { file: files });
        Some(Schema::new(format!("catoptra.{name}"), "protobuf", bytes))
    }

    fn get_message_encoding() -> String {
        M::get_message_encoding()
    }

    fn encode(&self, buffer: &mut impl BufMut) -> Result<(), Self::Error> {
        self.0.encode(buffer)
    }
}
