/* Witness of a light: a photodiode on an Arduino Uno (ATmega328P, 16 MHz), its voltage on A0 (0 to 5 V, more is brighter).

   57600 baud, 8N1. Unasked, a hundred times a second:
     L SEQUENCE MILLISECONDS LEVEL CHECK
   SEQUENCE 0 to 65535; MILLISECONDS of the board's clock when the line was begun; LEVEL the highest of all conversions
   since the line before, 0 to 1023 of 5 V; CHECK the CRC-8 (0x07) of all before the last space. "I" and a line feed ->
   "LIGHT 1.1", also said at every reset. It switches nothing, and nothing that is sent to it changes a reading.

   The converter runs all the while, also while a line is said, 9600 times a second: a light that is pulsed, as a dimmed
   one is, is seen lit in every line and not by chance in some.

   Build and flash: README.md */
#include "../../transports/firmware/board_line.h"

#define EVERY_MS 10

static volatile unsigned int highest;

ISR(ADC_vect) {
    unsigned int reading = ADC;
    if (reading > highest) highest = reading;
}

static unsigned int level(void) {
    cli();
    unsigned int reading = highest;
    highest = 0;
    sei();
    return reading;
}

static void say_reading(unsigned int sequence, unsigned long at, unsigned int reading) {
    crc = 0;
    say("L ");
    say_number(sequence);
    put(' ');
    say_number(at);
    put(' ');
    say_number(reading);
    say_check();
}

int main(void) {
    unsigned int sequence = 0;
    unsigned long last = 0;
    ADMUX = 1 << REFS0; /* reference AVCC, channel 0 */
    ADCSRB = 0;         /* free running */
    /* 125 kHz: 0.1 ms a conversion */
    ADCSRA = (1 << ADEN) | (1 << ADATE) | (1 << ADIE) | (1 << ADPS2) | (1 << ADPS1) | (1 << ADPS0) | (1 << ADSC);
    begin();
    say("LIGHT 1.1\n");
    for (;;) {
        if (was_asked()) say("LIGHT 1.1\n");
        unsigned long at = now();
        if (at - last < EVERY_MS) continue;
        last = at;
        say_reading(sequence++, at, level());
    }
}
