// SPDX-License-Identifier: Apache-2.0
/// @file PNG, JPEG, PGM, PPM, BMP and TIFF in memory. Not API: image_io.cpp reads and writes files
/// with it.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "examples/sequence/types.hpp"

namespace seq::detail {

constexpr int max_side = 16384;

/// Whether the content begins with the format's signature.
bool is_png(std::vector<std::uint8_t> const& bytes);
bool is_jpeg(std::vector<std::uint8_t> const& bytes);
bool is_pnm(std::vector<std::uint8_t> const& bytes);  ///< binary PGM or PPM
bool is_bmp(std::vector<std::uint8_t> const& bytes);
bool is_tiff(std::vector<std::uint8_t> const& bytes);
/// Whether this build has libtiff.
bool reads_tiff();
/// A PNG of one channel with 16 bits, alpha aside.
bool is_png_of_16_bits(std::vector<std::uint8_t> const& bytes);

/// The picture as 8-bit grey. @param path named by errors @throws seq::error
image read_png(std::string const& path, std::vector<std::uint8_t> const& bytes);
image read_jpeg(std::string const& path, std::vector<std::uint8_t> const& bytes);
image read_pnm(std::string const& path, std::vector<std::uint8_t> const& bytes);
image read_bmp(std::string const& path, std::vector<std::uint8_t> const& bytes);
image read_tiff(std::string const& path, std::vector<std::uint8_t> const& bytes);

/// Samples of a TIFF, row-major, those of a pixel side by side: one or three; black is 0.
struct tiff_samples {
  int width = 0, height = 0, channels = 1, bits = 8;
  std::vector<std::uint16_t> values;
};
tiff_samples read_tiff_samples(std::string const& path, std::vector<std::uint8_t> const& bytes);

/// A picture of one channel with 16 bits. @throws seq::error also for any other
depth_image read_png_depth(std::string const& path, std::vector<std::uint8_t> const& bytes);
std::vector<std::uint8_t> write_png_depth(std::string const& name, depth_image const& depth);

/// Reads only the header. @throws seq::error
void read_png_size(std::string const& path, std::vector<std::uint8_t> const& bytes, int& width,
                   int& height);
void read_jpeg_size(std::string const& path, std::vector<std::uint8_t> const& bytes, int& width,
                    int& height);
void read_pnm_size(std::string const& path, std::vector<std::uint8_t> const& bytes, int& width,
                   int& height);
void read_bmp_size(std::string const& path, std::vector<std::uint8_t> const& bytes, int& width,
                   int& height);
void read_tiff_size(std::string const& path, std::vector<std::uint8_t> const& bytes, int& width,
                    int& height);

/// @param name named by errors @throws seq::error
std::vector<std::uint8_t> write_png(std::string const& name, image const& picture, int compression);
std::vector<std::uint8_t> write_jpeg(std::string const& name, image const& picture, int quality);

[[noreturn]] void fail(std::string const& path, std::string const& reason);
/// @throws seq::error for a side of 0 or above max_side
void check_side(std::string const& path, unsigned long width, unsigned long height);
/// @throws seq::error if the sides cannot be written or do not fit the number of pixels
void check_picture(std::string const& name, image const& picture);

}  // namespace seq::detail
