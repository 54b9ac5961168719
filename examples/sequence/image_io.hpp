// SPDX-License-Identifier: Apache-2.0
/// @file Reads and writes image files: PNG and JPEG with libpng and libjpeg; reads PGM, PPM, BMP,
/// and TIFF if the build has libtiff.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "examples/sequence/types.hpp"

namespace seq {

/// Reads a PNG, JPEG, binary PGM or PPM, BMP, or TIFF (recognised by content) as 8-bit grey. Colour
/// is decoded to RGB and converted as OpenCV does it (examples/sequence/grey.hpp), 16-bit samples
/// keep their high byte, those of a PGM with another largest value (1023, 4095) are scaled by it,
/// alpha is ignored. Bytes after the end of a JPEG, and extra bytes between its segments, are
/// skipped.
/// @param bits that hold the 16-bit samples of a PNG or TIFF of one channel, 8 to 16; larger
///   samples are white
/// @throws seq::error naming the file: missing, not an image, damaged, truncated, or larger than
///   16384 a side
image read_image(std::string const& path, int bits = 16);

/// The largest sample of a PNG or TIFF of one channel with 16 bits; -1 for any other image.
/// @throws seq::error as read_image
int largest_sample_of_16_bits(std::string const& path);

/// Reads a depth image: a PNG or TIFF of one channel with 16 bits. @throws seq::error as
/// read_image, and for any other kind of image
depth_image read_depth_image(std::string const& path);

/// Width and height without decoding the pixels. @throws seq::error
void read_image_size(std::string const& path, int& width, int& height);

/// Writes an 8-bit grey PNG. @param compression zlib level 0..9 (1 is fast and good enough)
/// @throws seq::error
void write_png(std::string const& path, image const& picture, int compression = 1);

/// Writes a PNG of one channel with 16 bits. @throws seq::error
void write_depth_png(std::string const& path, depth_image const& depth);

/// The bytes of an 8-bit grey PNG, for embedding. @throws seq::error
std::vector<std::uint8_t> encode_png(image const& picture, int compression = 6);

/// The bytes of an 8-bit grey JPEG. @param quality 1..100 @throws seq::error
std::vector<std::uint8_t> encode_jpeg(image const& picture, int quality = 85);

}  // namespace seq
