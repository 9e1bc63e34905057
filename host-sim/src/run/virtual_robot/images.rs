//! The images that the boards run.

use crate::base::error::Error;
use crate::targets::images;
use core_algos::hil::framing::crc32c;
use core_algos::topology::Role;
use std::path::Path;
use std::sync::Arc;
use virtual_board::image::Image;

/// An axle's image and the beam's.
#[derive(Clone)]
pub struct Images {
    front: Arc<Image>,
    rear: Arc<Image>,
    beam: Arc<Image>,
}

impl Images {
    /// The images that users flash, built if they are not up to date; a file that is given takes the
    /// place of one.
    pub fn open(
        front: Option<&Path>,
        rear: Option<&Path>,
        beam: Option<&Path>,
    ) -> Result<Self, Error> {
        let given = |(file, package): (&Path, &str)| {
            let image = Image::open(file).map_err(|error| Error::input(error.to_string()))?;
            check(file, &image, package)?;
            Ok::<_, Error>(Arc::new(image))
        };
        let built = |package: &str| {
            let bytes = images::build(package, None)?;
            let image = Image::parse(package, bytes);
            Ok::<_, Error>(Arc::new(
                image.map_err(|error| Error::Failure(error.to_string()))?,
            ))
        };
        // Files first: a wrong one is told before anything is built.
        let [axle, beam_board] = ["firmware-axle", "firmware-beam"];
        let files = [(front, axle), (rear, axle), (beam, beam_board)];
        let [front, rear, beam] =
            files.map(|(file, package)| file.map(|file| given((file, package))).transpose());
        let (front, rear, beam) = (front?, rear?, beam?);
        let axle = match (&front, &rear) {
            (Some(axle), Some(_)) => axle.clone(),
            _ => built("firmware-axle")?,
        };
        Ok(Self {
            front: front.unwrap_or_else(|| axle.clone()),
            rear: rear.unwrap_or(axle),
            beam: beam.map_or_else(|| built("firmware-beam"), Ok)?,
        })
    }

    /// Name of a board's image: checksum of the flashed bytes (CRC-32C).
    pub fn name(&self, role: Role) -> String {
        let segments = self.of(role).segments().iter();
        let bytes: Vec<u8> = segments.flat_map(|segment| segment.data.clone()).collect();
        format!("virtual, image {:08x}", crc32c(&bytes))
    }

    /// The image of a board.
    pub fn of(&self, role: Role) -> &Image {
        match role {
            Role::Front => &self.front,
            Role::Rear => &self.rear,
            Role::Beam => &self.beam,
        }
    }
}

/// Refuses an image that says it is of another board or another variant than the one users flash: the first line
/// of its log (name, version, variant if any, hash). An image that does not say what it is passes.
fn check(file: &Path, image: &Image, package: &str) -> Result<(), Error> {
    for segment in image.segments() {
        for place in 0..segment.data.len() {
            let text = &segment.data[place..];
            if !text.starts_with(b"firmware-axle ") && !text.starts_with(b"firmware-beam ") {
                continue;
            }
            let text = String::from_utf8_lossy(&text[..text.len().min(64)]).into_owned();
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            let variant = words
                .get(2)
                .copied()
                .filter(|word| ["hil", "emulated"].contains(word));
            if words[0] != package || variant.is_some() {
                return Err(Error::input(format!(
                    "{}: {}, {} image: must be a {package} image of the default variant",
                    file.display(),
                    words[0],
                    variant.unwrap_or("default"),
                )));
            }
        }
    }
    Ok(())
}
