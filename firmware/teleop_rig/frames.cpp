#include "frames.h"

#include <string.h>

namespace teleop_rig {
namespace {

constexpr size_t kHead = 8;
constexpr size_t kCrc = 4;

}  // namespace

uint32_t crc32(const uint8_t* data, size_t length) {
  uint32_t crc = 0xFFFFFFFFu;
  for (size_t i = 0; i < length; ++i) {
    crc ^= data[i];
    for (int bit = 0; bit < 8; ++bit) {
      crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
  }
  return ~crc;
}

size_t cobs_encode(const uint8_t* data, size_t length, uint8_t* out) {
  size_t code_at = 0, at = 1;
  uint8_t code = 1;
  for (size_t i = 0; i < length; ++i) {
    if (at + 2 > kLargest) return 0;
    if (data[i] != 0) {
      out[at++] = data[i];
      ++code;
    }
    const bool full = code == 0xFF;
    if (data[i] == 0 || (full && i + 1 < length)) {
      out[code_at] = code;
      code_at = at++;
      code = 1;
    }
  }
  out[code_at] = code;
  return at;
}

size_t cobs_decode(const uint8_t* data, size_t length, uint8_t* out) {
  size_t at = 0, written = 0;
  while (at < length) {
    const uint8_t code = data[at];
    if (code == 0 || at + code > length || written + code > kLargest) return 0;
    memcpy(out + written, data + at + 1, code - 1u);
    written += code - 1u;
    at += code;
    if (code < 0xFF && at < length) out[written++] = 0;
  }
  return written;
}

size_t encode(const Frame& frame, uint8_t* out) {
  uint8_t payload[kLargest];
  const size_t length = kHead + frame.length;
  if (length + kCrc + 4 > kLargest) return 0;
  payload[0] = kVersion;
  payload[1] = frame.kind;
  put16(payload + 2, frame.sequence);
  put32(payload + 4, frame.time_us);
  memcpy(payload + kHead, frame.body, frame.length);
  put32(payload + length, crc32(payload, length));
  const size_t coded = cobs_encode(payload, length + kCrc, out);
  if (coded == 0) return 0;
  out[coded] = 0;
  return coded + 1;
}

bool decode(const uint8_t* data, size_t length, uint8_t* payload, Frame* frame) {
  const size_t whole = cobs_decode(data, length, payload);
  if (whole < kHead + kCrc) return false;
  const size_t covered = whole - kCrc;
  if (get32(payload + covered) != crc32(payload, covered)) return false;
  if (payload[0] != kVersion) return false;
  frame->kind = payload[1];
  frame->sequence = get16(payload + 2);
  frame->time_us = get32(payload + 4);
  frame->body = payload + kHead;
  frame->length = covered - kHead;
  return true;
}

}  // namespace teleop_rig
