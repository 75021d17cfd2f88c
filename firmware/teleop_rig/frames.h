// The line protocol: frames as bytes, and nothing else. Described in firmware/README.md.
#pragma once
#include <stddef.h>
#include <stdint.h>

namespace teleop_rig {

constexpr uint8_t kVersion = 1;
constexpr size_t kLargest = 256;  // [B] of a frame with its zero
constexpr int32_t kMissing = INT32_MIN;  // a value that was not read, a motor that is not used

enum Kind : uint8_t { kHello = 1, kSet = 2, kStop = 3, kInfo = 129, kState = 130 };

enum Flags : uint8_t {
  kEnabled = 1,
  kWatchdog = 2,
  kStopped = 4,
  kMotorFault = 8,
  kCellFault = 16,
};

struct Frame {
  uint8_t kind;
  uint16_t sequence;
  uint32_t time_us;
  const uint8_t* body;
  size_t length;  // of the body
};

uint32_t crc32(const uint8_t* data, size_t length);

// Both return the number of bytes written to `out`, which has room for kLargest; 0 if impossible.
size_t cobs_encode(const uint8_t* data, size_t length, uint8_t* out);
size_t cobs_decode(const uint8_t* data, size_t length, uint8_t* out);

// Returns the number of bytes of the whole frame with its zero; 0 if it is too long.
size_t encode(const Frame& frame, uint8_t* out);

// Reads a frame without its zero; `payload`, of kLargest bytes, keeps what `frame.body` points to.
bool decode(const uint8_t* data, size_t length, uint8_t* payload, Frame* frame);

inline void put16(uint8_t* out, uint16_t value) {
  out[0] = static_cast<uint8_t>(value);
  out[1] = static_cast<uint8_t>(value >> 8);
}
inline void put32(uint8_t* out, uint32_t value) {
  put16(out, static_cast<uint16_t>(value));
  put16(out + 2, static_cast<uint16_t>(value >> 16));
}
inline uint16_t get16(const uint8_t* in) {
  return static_cast<uint16_t>(in[0] | (in[1] << 8));
}
inline uint32_t get32(const uint8_t* in) {
  return static_cast<uint32_t>(get16(in)) | (static_cast<uint32_t>(get16(in + 2)) << 16);
}

}  // namespace teleop_rig
