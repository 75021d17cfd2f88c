// The library Encoder: counts that a test provides, by the first of the two pins.
#pragma once
#include <stdint.h>

class Encoder {
 public:
  Encoder(uint8_t a, uint8_t b) : pin_(a) { (void)b; }
  int32_t read();

 private:
  uint8_t pin_;
};
