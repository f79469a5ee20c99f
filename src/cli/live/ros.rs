//! `catoptra live --ros2`: the topics live over DDS. Builds without the feature `ros2` say so.

use super::super::Failure;
use crate::live::CurrentSource;
use crate::rig::Rig;
use crate::series::CurrentTable;
use crate::sink::{PictureCount, Sink};
use clap::builder::RangedU64ValueParser;
use std::sync::Arc;

/// The largest domain whose ports exist on every system.
const LAST_DOMAIN: u64 = 101;
/// The variable from which ROS takes the domain.
const DOMAIN_VARIABLE: &str = "ROS_DOMAIN_ID";

/// Options of `catoptra live` for ROS 2.
#[derive(Debug, clap::Args)]
pub(super) struct RosArgs {
    /// Publish to ROS 2: local (this computer) or network [default: local]
    #[arg(long, value_enum, value_name = "WHERE", num_args = 0..=1, default_missing_value = "local")]
    #[arg(hide_possible_values = true)]
    ros2: Option<NetworkScope>,
    /// ROS 2: the domain [default: ROS_DOMAIN_ID, or 0]
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<u16>::new().range(0..=LAST_DOMAIN))]
    domain: Option<u16>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum NetworkScope {
    Local,
    Network,
}

impl RosArgs {
    fn domain(&self) -> Result<u16, Failure> {
        if let Some(domain) = self.domain {
            return Ok(domain);
        }
        let Ok(text) = std::env::var(DOMAIN_VARIABLE) else { return Ok(0) };
        let domain = text.trim().parse().ok().filter(|domain| u64::from(*domain) <= LAST_DOMAIN);
        domain.ok_or_else(|| {
            let wrong =
                format!("{DOMAIN_VARIABLE} is `{text}`, expected a number from 0 to {LAST_DOMAIN}; or give --domain");
            Failure::usage(wrong)
        })
    }

    /// The topics, if they are wanted; with the count of pictures, if they are recorded.
    ///
    /// # Errors
    /// When no participant can be created, or this build has no DDS.
    pub(super) fn open(
        &self,
        rig: &Rig,
        pictures: Option<Arc<PictureCount>>,
    ) -> Result<Option<Box<dyn Sink + Send>>, Failure> {
        let Some(reach) = self.ros2 else { return Ok(None) };
        let domain = self.domain()?;
        published(domain, reach == NetworkScope::Network, rig, pictures).map(Some)
    }

    /// The source of currents, in the domain and on the networks of the others; a list is read.
    ///
    /// # Errors
    /// When the domain is invalid, or a list cannot be read.
    pub(super) fn of_currents(&self, from: &CurrentSource) -> Result<CurrentSource, Failure> {
        match from {
            CurrentSource::Ros2 { topic, .. } => Ok(CurrentSource::Ros2 {
                topic: topic.clone(),
                domain: self.domain()?,
                everywhere: self.ros2 == Some(NetworkScope::Network),
            }),
            CurrentSource::Play { list, .. } => {
                let table = CurrentTable::read(list).map_err(Failure::usage)?.to_text();
                Ok(CurrentSource::Play { list: list.clone(), table })
            }
            other => Ok(other.clone()),
        }
    }
}

#[cfg(feature = "ros2")]
fn published(
    domain: u16,
    everywhere: bool,
    rig: &Rig,
    pictures: Option<Arc<PictureCount>>,
) -> Result<Box<dyn Sink + Send>, Failure> {
    let sink =
        crate::sink::RosSink::open(domain, everywhere, rig).map_err(|e| Failure::new(super::super::Exit::Failed, e))?;
    let sink = match pictures {
        Some(count) => sink.with_picture_count(count),
        None => sink,
    };
    let where_to = if everywhere { "all networks" } else { "this computer alone" };
    tracing::info!("ROS 2: the topics are in domain {domain}, on {where_to}");
    Ok(Box::new(sink))
}

#[cfg(not(feature = "ros2"))]
fn published(_: u16, _: bool, _: &Rig, _: Option<Arc<PictureCount>>) -> Result<Box<dyn Sink + Send>, Failure> {
    let text = "--ros2: this build knows no ROS 2; install it with `cargo install --locked --path . --features ros2`";
    Err(Failure::usage(text))
}
