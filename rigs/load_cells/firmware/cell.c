/* Load cell: an HX711 on an Arduino Uno (ATmega328P, 16 MHz); DT on PD3 (pin 3), SCK on PD2 (pin 2).

   57600 baud, 8N1. Unasked, each reading is one line:
     R SEQUENCE MILLISECONDS COUNTS STATUS CHECK
   SEQUENCE 0 to 65535; MILLISECONDS of the board's clock; COUNTS -8388608 to 8388607; STATUS 0 good, 1 end of scale,
   2 DT does not rise after the last pulse, as an HX711's does; CHECK the CRC-8 (0x07) of all before the last space.
   "I" and a line feed -> "CELL 1.0", also said at every reset. Nothing else changes anything: there is no tare here.

   The HX711 (its data sheet): DT low says that a reading is there; 24 pulses shift it out, most significant bit first,
   a 25th chooses channel A with gain 128 for the next one; SCK high for more than 60 us puts it to sleep. So pulses are
   sent with interrupts off: 0.2 ms, less than one byte of the line takes.

   Build and flash: README.md */
#include "../../transports/firmware/board_line.h"

#define CLOCK_UP() (PORTD |= 1 << PD2)
#define CLOCK_DOWN() (PORTD &= ~(1 << PD2))
#define DATA() (PIND & (1 << PD3))
#define BITS 24
#define GAIN_PULSES 1
#define PACE_MS 10 /* of an amplifier that is always ready: it is none */

static void pause(void) { __builtin_avr_delay_cycles(32); } /* 2 us; the data sheet wants 0.2 us at least */

static unsigned char pulse(void) {
    CLOCK_UP();
    pause();
    unsigned char high = DATA() != 0;
    CLOCK_DOWN();
    pause();
    return high;
}

static void say_reading(unsigned int sequence, unsigned long at, unsigned long raw, unsigned char is_deaf) {
    unsigned char status = is_deaf ? 2 : raw == 0x7FFFFF || raw == 0x800000;
    crc = 0;
    say("R ");
    say_number(sequence);
    put(' ');
    say_number(at);
    put(' ');
    if (raw & 0x800000) { put('-'); say_number(0x1000000 - raw); }
    else say_number(raw);
    put(' ');
    put('0' + status);
    say_check();
}

int main(void) {
    unsigned int sequence = 0;
    unsigned long last = 0;
    CLOCK_DOWN();
    DDRD |= 1 << PD2;
    PORTD |= 1 << PD3; /* pulled up: a broken wire is never ready, and the host misses its readings */
    begin();
    say("CELL 1.0\n");
    for (;;) {
        if (was_asked()) say("CELL 1.0\n");
        if (DATA() || now() - last < PACE_MS) continue;
        unsigned long at = last = now(), raw = 0;
        cli();
        for (unsigned char bit = 0; bit < BITS; bit++) raw = raw << 1 | pulse();
        for (unsigned char more = 0; more < GAIN_PULSES; more++) pulse();
        unsigned char is_deaf = !DATA();
        sei();
        say_reading(sequence++, at, raw, is_deaf);
    }
}
